"""Page: common parts of all pages and plots: colours, figures, wording, templates.

A stage keeps the template of its own page beside the code that fills it.
"""
