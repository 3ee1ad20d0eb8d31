"""Everything in docs/ that is generated: pictures and tables. `python -m pages` writes it again."""
