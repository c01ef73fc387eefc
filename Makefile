# make campfire: a film in renders/campfire. make test: lint, types and tests. Both set up .venv first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: campfire test lint types bench gallery clean

campfire: $(VENV)/.installed
	$(BIN)/tparticles render scenes/campfire.py --out renders/campfire --existing overwrite

test: lint types
	$(BIN)/python -m pytest -m "not serial" --numprocesses 2 --dist loadfile -rs
	$(BIN)/python -m pytest -m serial -rs

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-test
	$(BIN)/basedpyright

bench: $(VENV)/.installed-bench
	$(BIN)/python -m tests.bench

# The stills that the README shows.
gallery: $(VENV)/.installed
	for still in campfire-140-960x540 grinder-60-960x540 swirl-48-960x540 spring_box-30-640x360 cloth_drop-60-640x360 \
	        flag-42-640x360 jelly-30-640x360 rope_bridge-36-640x360; do \
	    size=$${still##*-}; rest=$${still%-*}; scene=$${rest%-*}; frame=$${rest#*-}; \
	    $(BIN)/tparticles render scenes/$$scene.py --quality draft --size $$size --frames $$frame --no-mp4 --quiet \
	        --out renders/gallery/$$scene --existing overwrite && \
	    cp renders/gallery/$$scene/frames/*$$frame.png renders/reference/$$scene.png || exit 1; \
	done

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v < (3, 14) else f"Python 3.11 to 3.13 is needed, $(PYTHON) is {v[0]}.{v[1]}: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)

# Editable, so that edits need no new install; pyproject.toml decides what is installed.
$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.installed-test: pyproject.toml | $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@

$(VENV)/.installed-bench: pyproject.toml | $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	touch $@

clean:
	rm -rf $(VENV) renders/campfire
