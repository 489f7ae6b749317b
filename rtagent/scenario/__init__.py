"""Scenario files: TOML that describes a whole run, validated as a whole, each error with its file and line."""

from rtagent.scenario.assemble import Assembly, assemble
from rtagent.scenario.load import Scenario, load, load_devices
from rtagent.scenario.schema import json_schema

__all__ = ["Assembly", "Scenario", "assemble", "json_schema", "load", "load_devices"]
