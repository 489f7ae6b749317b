"""The report of experiments: one page with every claim, figure and table, beside what the thesis says."""
