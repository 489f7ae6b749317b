"""A simulated Bento Arm that sorts objects by their weight (thesis, section 4.3): physics, trials, a driver."""
