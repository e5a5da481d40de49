#!/bin/sh
# Packs what scripts/package.sh has laid out into a Debian package, out/release/densecloud_VERSION_ARCHITECTURE.deb:
#
#     sh scripts/package.sh && sh scripts/package-debian.sh
set -eu
cd "$(dirname "$0")/.."
program=${CARGO_TARGET_DIR:-target}/dist/densecloud
version=$("$program" --version)
version=${version#densecloud }
architecture=$(dpkg --print-architecture)
from=out/release/densecloud-$version-$(uname -m)-linux
root=out/release/debian
# dpkg-deb takes it as every file's latest time.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}
export SOURCE_DATE_EPOCH

rm -rf "$root"
documents=$root/usr/share/doc/densecloud
mkdir -p "$root/DEBIAN" "$root/usr/bin" "$root/usr/lib/densecloud" "$root/usr/lib/systemd/system" "$root/usr/share/man/man1" \
    "$root/usr/share/bash-completion/completions" "$root/usr/share/zsh/vendor-completions" \
    "$root/usr/share/fish/vendor_completions.d" "$documents"
# The library lies beside the program, which a link leads to.
cp "$from/densecloud" "$from/libonnxruntime.so" "$root/usr/lib/densecloud"
ln -s ../lib/densecloud/densecloud "$root/usr/bin/densecloud"
# Packages have their programs elsewhere than those who copy them.
sed 's#/opt/densecloud/densecloud#/usr/lib/densecloud/densecloud#; s# in /opt/densecloud,# in /usr/lib/densecloud,#' deploy/densecloud.service > "$root/usr/lib/systemd/system/densecloud.service"
for page in "$from"/man/man1/*; do
    gzip -9nc "$page" > "$root/usr/share/man/man1/$(basename "$page").gz"
done
cp "$from/completions/densecloud.bash" "$root/usr/share/bash-completion/completions/densecloud"
cp "$from/completions/densecloud.zsh" "$root/usr/share/zsh/vendor-completions/_densecloud"
cp "$from/completions/densecloud.fish" "$root/usr/share/fish/vendor_completions.d"
cp -R "$from/deploy" "$from/licences" "$from/model.toml" "$from/LICENSE-MIT" "$from/LICENSE-APACHE" "$documents"
gzip -9nc CHANGELOG.md > "$documents/changelog.gz"
{
    echo 'densecloud is under either of the licences MIT or Apache 2.0, at your option; licences/ here has those of what is inside.'
    echo
    cat LICENSE-MIT
    echo
    cat LICENSE-APACHE
} > "$documents/copyright"
mkdir -p "$root/etc/densecloud"
cp deploy/densecloud.toml "$root/etc/densecloud"
echo /etc/densecloud/densecloud.toml > "$root/DEBIAN/conffiles"
cat > "$root/DEBIAN/control" <<CONTROL
Package: densecloud
Version: $version
Architecture: $architecture
Maintainer: densecloud maintainers <maintainers@localhost>
Installed-Size: $(du -sk "$root/usr" | cut -f1)
Depends: libc6 (>= 2.36), libstdc++6, libgcc-s1
Section: science
Priority: optional
Description: makes sparse, noisy 3D point clouds dense
 One program with a trained network inside: at the command line, in a
 browser and as a service. PLY, LAS, LAZ, COPC, E57, PCD and others.
CONTROL
chmod -R u=rwX,go=rX "$root"
dpkg-deb --root-owner-group -Zxz --build "$root" "out/release/densecloud_${version}_$architecture.deb" > /dev/null
rm -rf "$root"
echo "out/release/densecloud_${version}_$architecture.deb"
