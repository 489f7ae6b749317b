"""An emulated board: what our sketches do, and what older ones do, on a pseudo-terminal."""
