"""Push buttons: a key of the terminal, or a message from a socket."""

from rtagent_drivers.button.driver import Button

__all__ = ["Button"]
