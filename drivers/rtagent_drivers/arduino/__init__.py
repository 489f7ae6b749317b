"""Arduino boards on a serial line: sensors at a steady rate, hobby servos, and a heartbeat that guards them."""
