#!/bin/sh
# The documents as a site, with a search: out/book/book/index.html. mdBook is built from crates.io, once.
set -eu
cd "$(dirname "$0")/.."

version=0.5.4
mdbook=vendor/mdbook/bin/mdbook
if ! "$mdbook" --version 2>/dev/null | grep -q "v$version\$"; then
    cargo install --locked --version "$version" --root vendor/mdbook mdbook
fi
python3 docs/book/build.py --mdbook "$mdbook" --out out/book
echo "The site begins at out/book/book/index.html."
