"""Page: what every page and picture has in common: colours, figures, wording, templates.

A stage keeps the template of its own page beside the code that fills it.
"""
