"""Sweeps: many measurements that do not need each other, in several processes, gone on with after a kill."""
