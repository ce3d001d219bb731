"""Report: one page with what was run, the results, and what is missing."""
