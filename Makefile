# `make check`: all a commit must pass, in the present environment. `make full`: also what needs
# extras. `make fix`: format and mend what can be mended.
PYTHON ?= python

check:
	$(PYTHON) check.py

full:
	$(PYTHON) check.py --full

fix:
	$(PYTHON) -m ruff check --fix .
	$(PYTHON) -m ruff format .

.PHONY: check full fix
