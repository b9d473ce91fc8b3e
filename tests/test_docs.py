"""The documentation holds together: links, table of contents, names, and the built site."""

import csv
import html
import importlib
import os
import pkgutil
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import imgscale
from imgscale import datasets

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
MARKDOWN = [ROOT / "README.md", ROOT / "CHANGELOG.md", *PAGES]
BUILDERS = ("sphinx", "furo", "myst_parser", "numpydoc", "sphinx_copybutton", "sphinx_gallery")

# --- what is written ---


def prose(path):
    """The text of a Markdown page without its blocks of code."""
    return re.sub(
        r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )


def local_links(path):
    targets = re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", prose(path)))
    return [target for target in targets if not re.match(r"https?://|mailto:", target)]


def anchors(path):
    """The anchors that a forge gives to the headings of a page."""
    headings = re.findall(r"^#{1,3} (.+)$", prose(path), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in headings}


def is_there(path, target):
    file, _, anchor = target.partition("#")
    found = (path.parent / file).resolve() if file else path
    if found == DOCS / "gallery" / "index.rst":  # made by the build, from this
        found = ROOT / "examples" / "GALLERY_HEADER.rst"
    return found.exists() and (not anchor or anchor in anchors(found))


@pytest.mark.parametrize("path", MARKDOWN, ids=lambda path: path.name)
def test_links_and_pictures_are_there(path):
    assert [target for target in local_links(path) if not is_there(path, target)] == []


def test_links_are_found_at_all():
    assert len(local_links(ROOT / "README.md")) > 5
    assert not is_there(ROOT / "README.md", "docs/nowhere.md")
    assert not is_there(ROOT / "README.md", "docs/inputs.md#nowhere")


def test_every_page_is_in_the_table_of_contents_once():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = [
        line
        for block in re.findall(r"^```{toctree}\n(.*?)^```", index, flags=re.DOTALL | re.MULTILINE)
        for line in block.splitlines()
        if line and not line.startswith(":")
    ]
    pages = [path.stem for path in PAGES if path.stem != "index"]
    assert sorted(listed) == sorted([*pages, "gallery/index"])


# --- the reference ---


def public_modules():
    """The face of the package, the modules that users import by name, and the data sets."""
    named = (
        "batch",
        "detectors",
        "depth_sources",
        "explaining",
        "measuring",
        "order_statistics",
        "plotting",
        "report",
    )
    data_sets = (f"datasets.{module.name}" for module in pkgutil.iter_modules(datasets.__path__))
    return ["imgscale", *(f"imgscale.{name}" for name in (*named, *data_sets))]


def documented_names():
    """Each name of the reference, with its module."""
    module, names = "", set()
    pages = (path.read_text(encoding="utf-8") for path in PAGES if path.stem.startswith("api"))
    for line in "\n".join(pages).splitlines():
        if found := re.match(r"\.\. currentmodule:: (\S+)$", line):
            module = found[1]
        elif found := re.match(r"(?:   |\.\. py:data:: )([A-Za-z]\w*)$", line):
            names.add(f"{module}.{found[1]}")
    return names


def objects(names):
    """What the names stand for: one object may be public in two modules."""
    split = (name.rpartition(".") for name in names)
    return {id(getattr(importlib.import_module(module), name)) for module, _, name in split}


def test_every_public_name_is_in_the_reference():
    documented = objects(documented_names())
    missing = [
        f"{module}.{name}"
        for module in public_modules()
        for name in importlib.import_module(module).__all__
        if id(getattr(importlib.import_module(module), name)) not in documented
    ]
    assert missing == []


def test_every_name_of_the_reference_is_public():
    for name in documented_names():
        module, _, attribute = name.rpartition(".")
        assert attribute in importlib.import_module(module).__all__, name


# --- the built site ---


class Page(HTMLParser):
    """Anchors, links and what a browser loads by itself."""

    def __init__(self, path):
        super().__init__()
        self.path = path
        self.ids, self.links, self.loads = set(), [], []
        self.rows = 0
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.ids |= {found[key] for key in ("id", "name") if found.get(key)}
        self.rows += tag == "tr"
        if tag == "a" and found.get("href"):
            self.links.append(found["href"])
        elif tag == "link" and found.get("href"):
            self.loads.append(found["href"])
        for key in ("src", "data", "poster"):
            if found.get(key) and tag != "a":
                self.loads.append(found[key])
        for source in (found.get("srcset") or "").split(","):
            self.loads += source.split()[:1]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    for name in BUILDERS:
        pytest.importorskip(name, reason=f"{name} builds the documentation")
    copy = tmp_path_factory.mktemp("docs") / "copy"
    made = shutil.ignore_patterns(".*", "_build", "gallery", "api", "__pycache__", "tests", "dist")
    shutil.copytree(ROOT, copy, ignore=made)
    built = copy / "site"
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "-q", "-D", "plot_gallery=0", "docs", str(built)],
        cwd=copy,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return {path.relative_to(built).as_posix(): Page(path) for path in built.rglob("*.html")}


def resolves(page, target, pages):
    """Tell whether a link of a page leads to a file, and to an anchor where it names one."""
    parts = urlsplit(target)
    path = page.path if not parts.path else (page.path.parent / unquote(parts.path)).resolve()
    if not path.is_file():
        return False
    by_path = {other.path: other for other in pages.values()}
    anchors_there = by_path[path].ids if path in by_path else set()
    return not parts.fragment or unquote(parts.fragment) in anchors_there


@pytest.mark.slow
def test_the_site_is_built_without_warnings_and_describes_every_name(site):
    described = set().union(*(page.ids for page in site.values()))
    assert documented_names() <= described
    assert {f"{path.stem}.html" for path in PAGES} <= site.keys()
    examples = [path.stem for path in (ROOT / "examples").glob("[a-z]*.py")]
    assert {f"gallery/{example}.html" for example in examples} <= site.keys()


@pytest.mark.slow
def test_all_links_of_the_site_resolve(site):
    broken = [
        f"{name}: {target}"
        for name, page in site.items()
        for target in (*page.links, *page.loads)
        if not urlsplit(target).scheme and target != "#" and not resolves(page, target, site)
    ]
    assert broken == []


@pytest.mark.slow
def test_no_page_loads_anything_from_elsewhere(site):
    outside = [
        f"{name}: {target}"
        for name, page in site.items()
        for target in page.loads
        if urlsplit(target).scheme not in {"", "data"} or target.startswith("//")
    ]
    assert outside == []
    folder = site["index.html"].path.parent / "_static"
    sheets = {path.name: path.read_text(encoding="utf-8") for path in folder.rglob("*.css")}
    assert "imgscale.css" in sheets
    loading = re.compile(r"@import|url\(\s*['\"]?(?:https?:)?//")
    assert [name for name, text in sheets.items() if loading.search(text)] == []


@pytest.mark.slow
def test_formulas_need_no_script(site):
    text = site["theory.html"].path.read_text(encoding="utf-8")
    assert text.count("<math") > 20
    assert "$$" not in text
    assert not [name for page in site.values() for name in page.loads if "mathjax" in name.lower()]


@pytest.mark.slow
def test_every_row_of_the_table_of_sizes_is_shown_with_its_source(site):
    file = Path(imgscale.__file__).parent / "tables" / "priors_2026_11.csv"
    with file.open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    page = site["priors.html"]
    text = html.unescape(page.path.read_text(encoding="utf-8"))
    assert [row["label"] for row in rows if row["source"] not in text] == []
    assert text.count("<td>") >= 4 * len(rows)
    assert page.rows >= len(rows)
