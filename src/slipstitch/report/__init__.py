"""Report: one page that shows what was run, what came out, and what is missing."""
