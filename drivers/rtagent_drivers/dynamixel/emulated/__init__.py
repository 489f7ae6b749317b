"""Servos that are not there: stateful, with motion, on a line with its true timing and with faults on demand."""
