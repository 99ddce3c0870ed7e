# SPDX-License-Identifier: Apache-2.0
"""Documents lead somewhere, and their sentences stay short."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
SHORT = [ROOT / "README.md", *(ROOT / "docs" / page for page in ("explanation/method.md", "reference/ros.md"))]
# Pages with at most 25 words a sentence; older ones are allowed more, or any number.
SHORTER = [ROOT / f"{page}.md" for page in ("CONTRIBUTING", "QUALITY_DECLARATION", "SECURITY")]
SHORTER += (ROOT / "docs").rglob("index.md")
SHORTER += (ROOT / "docs/tutorials").glob("*.md")
NEW_GUIDES = "foxglove gpus installing large-messages mujoco several-machines several-nodes troubleshooting"
SHORTER += (ROOT / "docs/how-to" / f"{page}.md" for page in NEW_GUIDES.split())
MOST_WORDS = 30
ABBREVIATIONS = r"\b(?:e\.g|i\.e|et al|cf|vs|no)\."


def name_of(page):
    return str(page.relative_to(ROOT))


def without_code(text):
    """The text without fenced blocks and without lines that are indented as code outside of lists."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"(?:(?<=\n\n)|\A)(?: {4}.*\n?|\n)+", "\n", text)


def anchors(page):
    """What links to the headings of a page may say behind the #, as GitHub makes it."""
    headings = re.findall(r"^#+ +(.*)$", without_code(page.read_text()), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def dead_links(page, text):
    """The targets of relative links in `text` that do not lead from `page` to a file, or to no heading of it."""
    dead = []
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code(text)):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path) if path else page
        if not there.exists() or (anchor and there.suffix == ".md" and anchor not in anchors(there)):
            dead.append(target)
    return dead


def sentences(text):
    """The sentences of a page, each with its words in one line; code, tables, headings and pictures are left out."""
    blocks = re.sub(r"^ *(?:\||#|!\[|@@).*$", "\n", without_code(text), flags=re.MULTILINE)
    blocks = re.sub(r"^ *(?:[-*]|\d+\.) ", "\n\n", blocks, flags=re.MULTILINE)
    for block in re.split(r"\n\s*\n", blocks):
        words = re.sub(r"\]\([^)]*\)", "]", " ".join(block.split()))
        words = re.sub(ABBREVIATIONS, lambda found: found[0][:-1], words)
        yield from (one for one in re.split(r"(?<=[.!?:])\)?\s+(?=[A-Z`~*\[(])", words) if one)


def long_sentences(text, most=MOST_WORDS):
    found = ((len(re.findall(r"\S*\w\S*", one)), one) for one in sentences(text))
    return [f"{count} words: {one}" for count, one in found if count > most]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_relative_links_lead_somewhere(page):
    assert not dead_links(page, page.read_text())


@pytest.mark.parametrize("page", SHORT, ids=name_of)
def test_sentences_are_short(page):
    assert not long_sentences(page.read_text())


@pytest.mark.parametrize("page", sorted(set(SHORTER)), ids=name_of)
def test_sentences_are_shorter_where_readers_begin(page):
    assert not long_sentences(page.read_text(), most=25)


def test_pages_are_all_in_one_of_the_four_parts():
    parts = {page.relative_to(ROOT / "docs").parts[0] for page in PAGES if ROOT / "docs" in page.parents}
    assert parts == {"index.md", "tutorials", "how-to", "reference", "explanation", "notes"}


@pytest.mark.long
def test_the_examples_of_many_worlds_run(tmp_path, monkeypatch):
    text = (ROOT / "docs" / "how-to" / "worlds.md").read_text()
    (vary,) = re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)
    (tmp_path / "vary.yaml").write_text(vary)
    monkeypatch.chdir(tmp_path)
    there: dict = {}
    for code in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(code.replace("worlds=16", 'device="cpu", worlds=16'), there)
    assert there["places"].shape == (16, 256, 3) and there["done"].shape == (16,)


def test_sphinx_builds_them_without_a_warning(tmp_path):
    """Every link and reference leads somewhere, every page is in a table of contents, and every docstring is sound."""
    for needed in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(needed)
    command = [sys.executable, "-m", "sphinx", "-W", "-n", "-q", "--keep-going", "-b", "html", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "reference/python.html").read_text()
    import cloth_sim_ros.sim

    assert all(f'id="cloth_sim_ros.sim.{name}"' in page for name in cloth_sim_ros.sim.__all__)
    assert 'id="cloth_sim_ros.sim.Simulation.set_handle_pose"' in page


def test_dead_links_are_found():
    page = "docs/how-to/extending.md"
    text = f"[a](README.md) [b](nowhere.md) [c]({page}#a-force) [d]({page}#a-farce) [e](https://x.y)"
    assert dead_links(ROOT / "README.md", text) == ["nowhere.md", f"{page}#a-farce"]


def test_long_sentences_are_found_outside_of_code_and_tables():
    long = " ".join(["word"] * 31)
    assert len(long_sentences(f"{long}.\n\nShort one. {long}. Short.\n\n- {long}\n- {long}\n")) == 4
    assert not long_sentences(
        f"# {long}\n\n| {long} |\n\n    {long}\n\n```\n{long}\n```\n\n{long[:100]}. And {long[:40]}.\n"
    )
