"""Dynamixel servos: codec, bus, driver, and an emulated bus."""
