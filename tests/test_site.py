"""The documentation as a site: it builds without a warning, loads nothing from elsewhere, and has the public API."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import lightdome
import pytest
from helpers import LONG, ROOT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site, which no warning stopped."""
    for name in ("mkdocs", "material", "mkdocstrings_handlers"):
        pytest.importorskip(name, reason="needs the extra [docs], on Python 3.11 or newer")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LONG)
    assert result.returncode == 0, result.stderr
    return folder


def test_every_page_is_there_and_can_be_found(site: Path) -> None:
    pages = [path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md")]
    built = {path.with_name("index.html" if path.name == "README.md" else f"{path.stem}.html") for path in pages}
    built |= {Path(name) for name in ("contributing.html", "changelog.html", "security.html", "maps.html")}
    assert {path.relative_to(site) for path in site.rglob("*.html")} == built | {Path("404.html")}
    found = {place["location"].partition("#")[0] for place in json.loads(index(site))["docs"]}
    assert found == {str(path) for path in built}


def index(site: Path) -> str:
    return (site / "search" / "search_index.json").read_text(encoding="utf-8")


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r"<(?:script|img|link|iframe)[^>]*(?:src|href)=[\"']?(?:https?:)?//[^>]*>", text), page
        for target in re.findall(r"<(?:script|img)[^>]* src=\"([^\"#?]+)", text):
            base = site if target.startswith("/") else page.parent  # of the page for a wrong address
            assert os.path.exists(f"{base}/{target}"), f"{page}: {target}"  # noqa: PTH110
    assert not re.findall(r"url\(\"?(?:https?:)?//", (site / "site.css").read_text(encoding="utf-8"))


def test_the_public_api_is_there_with_links(site: Path) -> None:
    text = (site / "api.html").read_text(encoding="utf-8")
    for name in set(lightdome.__all__) - {"__version__"}:
        assert f'id="lightdome.{name}"' in text, name
    assert '<a href="#lightdome.LightdomeError"><code>LightdomeError</code></a>' in text
    assert not re.findall(r":(?:class|func|mod|meth|data|attr):", text)


def test_formulas_are_pictures(site: Path) -> None:
    text = (site / "theory.html").read_text(encoding="utf-8")
    assert text.count('class="formula"') == (ROOT / "docs" / "theory.md").read_text(encoding="utf-8").count("```math")
    assert "$" not in re.sub(r"<(script|svg).*?</\1>", "", text, flags=re.DOTALL)
