"""Webcams: what is sensed of their newest frames."""

from rtagent_drivers.webcam.driver import Webcam

__all__ = ["Webcam"]
