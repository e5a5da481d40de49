# `make demo` makes a dense cloud from nothing; `make test` runs every test.

PROGRAM = $(or $(CARGO_TARGET_DIR),target)/release/densecloud
OUT = out/demo
PYTHON_CODE = training tests/interop tests/python tests/ray tests/cluster deploy/ray benches crates/python/python examples docs/book

.PHONY: demo cluster-demo test test-rust test-python test-web lint docs build book release wheel test-wheel onnxruntime venv clean

demo: build
	mkdir -p $(OUT)
	$(PROGRAM) sample shape:knot $(OUT)/sparse.ply --points 2500 --noise 0.0025
	$(PROGRAM) upsample $(OUT)/sparse.ply $(OUT)/dense.ply --ratio 16
	$(PROGRAM) render $(OUT)/sparse.ply $(OUT)/before-after.png --beside $(OUT)/dense.ply --size 800x600 --view 30,35
	@echo "The dense cloud is $(OUT)/dense.ply; before and after are in $(OUT)/before-after.png."

test: test-rust test-python test-web

# Tests that need a store or a database are ignored elsewhere.
test-rust: onnxruntime venv
	sh scripts/with-services.sh cargo test --workspace -- --include-ignored

test-python: venv
	.venv/bin/python -m pytest -q training/tests

# The page; its packages come from npm.
test-web: venv
	sh web/test.sh

lint: venv
	cargo fmt --check
	cargo clippy --workspace --all-targets -- -D warnings
	.venv/bin/python -m ruff check $(PYTHON_CODE)
	.venv/bin/python -m ruff format --check $(PYTHON_CODE)

# A fleet on this machine: Postgres, an S3, a server and three workers, one of which is killed on the way.
cluster-demo: build venv
	.venv/bin/python tests/cluster/demo.py --program $(PROGRAM)

docs:
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps

build: onnxruntime
	cargo build --release --package densecloud-cli

# Python's package, to hand out: out/wheels.
wheel:
	sh scripts/build-wheel.sh

test-wheel:
	sh tests/python/run.sh

# What is handed out: out/release.
release:
	sh scripts/release.sh

# The documents as a site: out/book.
book:
	sh scripts/build-book.sh

onnxruntime:
	sh scripts/fetch-onnxruntime.sh

venv:
	sh training/setup.sh

clean:
	cargo clean
	rm -rf out .venv .venv-interop .venv-maturin .venv-ray .venv-wheel vendor
