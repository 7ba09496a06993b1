"""The parts of the README files that are generated from tables of the code.

`make reference`, or `python -m reference` in tests/, writes them. tests/unit/test_reference.py
fails if a page and its table differ.
"""
