# SPDX-License-Identifier: Apache-2.0
"""Documents lead somewhere, and their sentences stay short."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SHORT = [ROOT / "README.md", *(ROOT / "docs" / page for page in ("explanation/method.md", "reference/ros.md"))]
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


def long_sentences(text):
    found = ((len(re.findall(r"\S*\w\S*", one)), one) for one in sentences(text))
    return [f"{count} words: {one}" for count, one in found if count > MOST_WORDS]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_relative_links_lead_somewhere(page):
    assert not dead_links(page, page.read_text())


@pytest.mark.parametrize("page", SHORT, ids=name_of)
def test_sentences_are_short(page):
    assert not long_sentences(page.read_text())


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
