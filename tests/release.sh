#!/bin/sh
# What `make release` has made, where there is nothing else: an empty environment and an empty folder. `sh tests/release.sh`
set -eu
cd "$(dirname "$0")/../out/release"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

sha256sum --check --quiet SHA256SUMS

# Nothing of this machine is in its environment.
alone() { env -i PATH=/usr/bin:/bin HOME="$work" TMPDIR="$work" "$@"; }
makes_dense() {
    alone "$1" sample shape:knot "$work/sparse.ply" --points 2500
    alone "$1" upsample "$work/sparse.ply" "$2" --ratio 4 --quiet
    alone "$1" inspect "$2" | grep -q '^points  *10000$'
}

mkdir "$work/tarball"
tar -C "$work/tarball" -xzf ./*.tar.gz
folder=$(echo "$work"/tarball/densecloud-*)
makes_dense "$folder/densecloud" "$work/one.ply"
for file in completions/densecloud.bash man/man1/densecloud-upsample.1 licences/crates/crates.txt model.toml; do
    test -s "$folder/$file"
done
bash -c '. "$1" && complete -p densecloud > /dev/null' - "$folder/completions/densecloud.bash"

# Twice from one build are the same bytes.
cp ./*.tar.gz "$work/before.tar.gz"
(cd ../.. && sh scripts/package.sh > /dev/null)
cmp "$work/before.tar.gz" ./*.tar.gz

if [ -n "$(echo ./*.deb | grep -v '\*')" ]; then
    dpkg-deb -x ./*.deb "$work/debian"
    makes_dense "$work/debian/usr/bin/densecloud" "$work/two.ply"
    cmp "$work/one.ply" "$work/two.ply"
    dpkg-deb --contents ./*.deb | awk '$2 != "root/root" { print "not root'\''s: " $0; exit 1 }'
    grep -q '^ExecStart=/usr/lib/densecloud/densecloud ' "$work/debian/usr/lib/systemd/system/densecloud.service"
    # As a machine has it: installed, run by its name, purged.
    if [ "$(id -u)" = 0 ] && [ "${DENSECLOUD_INSTALL:-}" = yes ]; then
        dpkg --install ./*.deb > /dev/null
        makes_dense densecloud "$work/three.ply"
        dpkg --purge densecloud > /dev/null
        test ! -e /usr/lib/densecloud && test ! -e /etc/densecloud
    fi
fi

python3 - ./*.cdx.json <<'PYTHON'
import json, sys

bill = json.load(open(sys.argv[1]))
names = {component["name"] for component in bill["components"]}
assert bill["bomFormat"] == "CycloneDX" and {"ort", "rayon", "clap"} <= names, sorted(names)[:20]
assert all(component.get("licenses") for component in bill["components"] if not component["name"].startswith("densecloud"))
print(f"{len(names)} components")
PYTHON
echo "all good"
