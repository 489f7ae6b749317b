"""The experiments of the thesis: each a list of cells, a function that measures one, and what is found in all."""
