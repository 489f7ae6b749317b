"""A joint that moves towards an egg, and a modelled person who presses a button to stop it."""

from rtagent_drivers.egg.driver import egg

__all__ = ["egg"]
