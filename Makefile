# make demo   the node on config/curtain.yaml, its driver, a status line and a page to look at; SCENE=towel takes another
#             one of config/, ARGS=--headless leaves the page out, ARGS="--seconds 10" ends it by itself
# make test   ruff and the tests, but for those marked `long`, which `make test-long` runs
# make extras what recording, export, learning, identification and MuJoCo need, beside what is there
# make docs   the reference of parameters from the code, and all documents as pages in docs/_build
# make dist   the wheel and the sdist in dist/, checked for what the Python registry asks
# All set up .venv first; the second time that takes no time. PYTHON=/path/to/python3 chooses an interpreter.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
VENV := .venv
RUN := $(VENV)/bin/python
# Three processes for two cores, as many tests wait for a node. A file stays in one, which compiles its kernels once.
# Each has one thread for NumPy: those of several processes would wait for one another, up to 20 times as long.
TESTS := OPENBLAS_NUM_THREADS=1 $(RUN) -m pytest -n 3 --dist loadfile
EXTRAS := record,export,learn,identify,study,mujoco
SOURCES := setup.py setup.cfg pyproject.toml Makefile

.PHONY: demo extras test test-long format docs dist clean

demo: $(VENV)/ready-to-run
	@exec $(RUN) -m cloth_sim_ros.demo $(SCENE) $(ARGS)

extras: $(VENV)/ready-to-run
	@echo "== Adding what recording, export, learning, identification and MuJoCo need"
	@$(RUN) -m pip install --disable-pip-version-check --quiet --editable '.[viewer,$(EXTRAS)]'
	@touch $(VENV)/has-extras
	@echo "== Done; docs/how-to tells what to do with it"

test: $(VENV)/ready-to-test
	@echo "== Checking style, then running the tests; a dot is a test. The first run compiles kernels, and says so."
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(TESTS) -m "not long"

test-long: $(VENV)/ready-to-test
	$(TESTS) -rs -m long

format: $(VENV)/ready-to-test
	$(RUN) -m ruff check --fix .
	$(RUN) -m ruff format .

docs: $(VENV)/ready-to-test
	$(RUN) -m cloth_sim_ros.ros.parameters.reference > docs/reference/parameters.md
	$(RUN) -m sphinx -W -n --keep-going -b html docs docs/_build

dist: $(VENV)/ready-to-test
	rm -rf dist
	$(RUN) -m build
	$(RUN) -m twine check --strict dist/*

clean:
	rm -rf $(VENV) docs/_build build dist install log *.egg-info

# Where rclpy is installed already, as by apt, it is used; elsewhere it comes as wheels from the Python registry. An
# environment that had the extras gets them again.
$(VENV)/ready-to-run: $(SOURCES)
	@python=""; \
	for candidate in $(PYTHON) python3 python3.12 python3.11 python3.13 python3.10; do \
	  if "$$candidate" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; \
	  then python="$$candidate"; break; fi; \
	done; \
	if [ -z "$$python" ]; then echo "No python3 of version 3.10 to 3.13 was found; name one: make PYTHON=..." >&2; exit 1; fi; \
	options=; if "$$python" -c 'import rclpy' 2>/dev/null; then options=--system-site-packages; fi; \
	echo "== Setting up $(VENV) with $$("$$python" --version); this is done once"; \
	extras=; if [ -e $(VENV)/has-extras ]; then extras=,$(EXTRAS); fi; \
	"$$python" -m venv --clear $$options $(VENV) || \
	  { echo "Python cannot make environments; on Debian and Ubuntu: sudo apt install python3-venv" >&2; exit 1; }; \
	if [ -n "$$extras" ]; then touch $(VENV)/has-extras; fi; \
	if $(RUN) -c 'import rclpy' 2>/dev/null; then what=".[viewer$$extras]"; echo "== Using the ROS 2 that is installed"; \
	else what=".[ros,viewer$$extras]"; echo "== Adding ROS 2 from wheels"; fi; \
	$(RUN) -m pip install --disable-pip-version-check --editable "$$what"; \
	touch $@; \
	echo "== $(VENV) is ready to run"

$(VENV)/ready-to-test: $(VENV)/ready-to-run
	@echo "== Adding what the tests need"
	@$(RUN) -m pip install --disable-pip-version-check --editable '.[test]'
	@touch $@
