"""Makes a site of the repository's documents, and refuses links that lead nowhere.

The documents keep their places, so that one set of links serves the repository and the site. What they link to comes
along; of a folder that is a list of its files.
"""

import argparse
import functools
import html.parser
import re
import shutil
import subprocess
import sys
import urllib.parse
from pathlib import Path

LINK = re.compile(r"(\]\()([^)#\s]+)(#[^)\s]*)?(\))")
HERE = Path(__file__).parent


class Page(html.parser.HTMLParser):
    """What a page links to, and what can be linked to on it."""

    def __init__(self, file: Path):
        super().__init__()
        self.links: list[str] = []
        self.names: set[str] = set()
        self.feed(file.read_text())

    def handle_starttag(self, tag, attrs):
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.links.append(value)
            elif name == "id" and value:
                self.names.add(value)


def is_outside(link: str) -> bool:
    return bool(urllib.parse.urlsplit(link).scheme) or link.startswith("//")


def gather(root: Path, into: Path) -> None:
    """Copies the chapters, and what they link to."""
    shutil.copy(HERE / "SUMMARY.md", into / "SUMMARY.md")
    for _, chapter, _, _ in LINK.findall((HERE / "SUMMARY.md").read_text()):
        target = into / chapter
        target.parent.mkdir(parents=True, exist_ok=True)
        with_links = functools.partial(bring, chapter=root / chapter, root=root, into=into)
        target.write_text(LINK.sub(with_links, (root / chapter).read_text()))


def bring(link: re.Match, chapter: Path, root: Path, into: Path) -> str:
    """Brings what a link leads to, and gives the link."""
    begin, address, place, end = link.groups()
    file = (chapter.parent / address).resolve()
    if address.endswith("README.md"):
        # That is how a chapter of this name is called.
        return link.group().replace("README.md", "index.md")
    if is_outside(address) or address.endswith(".md") or not file.exists():
        return link.group()
    target = into / file.relative_to(root)
    target.parent.mkdir(parents=True, exist_ok=True)
    if file.is_dir():
        listed(root, file, into)
        address = address.rstrip("/") + "/index.html"
    else:
        shutil.copy(file, target)
    return f"{begin}{address}{place or ''}{end}"


def listed(root: Path, folder: Path, into: Path) -> None:
    """A page of a folder's files, and these."""
    names = subprocess.run(
        ["git", "ls-files", "."], cwd=folder, check=True, capture_output=True, text=True
    ).stdout.split()
    for name in names:
        (into / folder.relative_to(root) / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / name, into / folder.relative_to(root) / name)
    rows = "".join(f'<li><a href="{name}">{name}</a></li>' for name in names if not name.endswith(".md"))
    page = f"<!DOCTYPE html><title>{folder.name}</title><ul>{rows}</ul>"
    (into / folder.relative_to(root) / "index.html").write_text(page)


def lost(site: Path, source: Path) -> list[str]:
    """Links of the site that lead nowhere, with the page that has them; pages that came along are left alone."""
    made = (file for file in site.rglob("*.html") if not (source / file.relative_to(site)).exists())
    pages = {file.resolve(): Page(file) for file in made}
    found = []
    for file, page in pages.items():
        for link in page.links:
            parts = urllib.parse.urlsplit(link)
            target = (file.parent / urllib.parse.unquote(parts.path)).resolve() if parts.path else file
            if is_outside(link) or file.name in ("print.html", "404.html"):
                continue
            is_there = target.is_file() and (
                not parts.fragment or target not in pages or parts.fragment in pages[target].names
            )
            if not is_there:
                found.append(f"{file.relative_to(site.resolve())}: {link}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mdbook", default="mdbook", help="the program")
    parser.add_argument("--out", type=Path, required=True, help="a folder, which is emptied")
    arguments = parser.parse_args()
    root = HERE.parent.parent.resolve()
    shutil.rmtree(arguments.out, ignore_errors=True)
    (arguments.out / "src").mkdir(parents=True)
    shutil.copy(HERE / "book.toml", arguments.out)
    gather(root, arguments.out / "src")
    subprocess.run([arguments.mdbook, "build", str(arguments.out)], check=True)
    links = lost(arguments.out / "book", arguments.out / "src")
    print("\n".join(f"leads nowhere: {link}" for link in links), file=sys.stderr)
    return 1 if links else 0


if __name__ == "__main__":
    sys.exit(main())
