"""Device drivers of rtagent, and their fakes: plug-ins of the entry-point group `rtagent.drivers`."""
