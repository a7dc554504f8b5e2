"""What the site adds to Markdown: formulas, pages from the clone's top folder, and links in docstrings.

MkDocs calls these functions (``mkdocs.yml``). GitHub shows the same pages without them.
"""

from __future__ import annotations

import re
from html import escape
from pathlib import Path

import matplotlib
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

# File in the clone: page of the site.
TOP = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "data/README.md": "maps.md",
}
SIZE, EM = 10, 9  # size of a letter, and the size that equals 1 em of the text, whose letters are wider
LETTERS = {Outline.MOVETO: "M", Outline.LINETO: "L", Outline.CURVE3: "Q", Outline.CURVE4: "C", Outline.CLOSEPOLY: "Z"}
CODE = r"^ *```(?!math).*?^ *```$|`[^`\n]+`"  # left unchanged


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie outside of docs/."""
    for there, here in TOP.items():
        files.append(File.generated(config, here, abs_src_path=str(Path(config.config_file_path).parent / there)))
    return files


def on_page_markdown(text: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links between the two folders to the site's pages, and draw formulas."""
    for there, here in TOP.items():
        text = re.sub(rf"\]\((?:\.\./)?{there}", f"]({here}", text)
    if page.file.src_uri in TOP.values():
        text = re.sub(r"\]\((?:\.\./)?docs/", "](", text)
    return re.sub(rf"{CODE}|^```math\n(.*?)^```$|\$([^$\n]+)\$|\]\[", shown, text, flags=re.MULTILINE | re.DOTALL)


def shown(found: re.Match[str]) -> str:
    """Draw a formula; make brackets text, because no link is by reference; leave code unchanged."""
    display, inline = found.groups()
    if display:
        return f'<div class="formula">{picture(" ".join(display.split()), displayed=True)}</div>'
    if inline:
        return picture(inline, displayed=False)
    return "]&#91;" if found[0] == "][" else found[0]


def picture(tex: str, displayed: bool) -> str:
    """A formula as SVG, on the baseline of the text and in its colour."""
    math = tex.replace(r"\bmod", r"\;\mathrm{mod}\;").replace(r"\frac", r"\dfrac" if displayed else r"\frac")
    math = re.sub(r"(\\(?:int|sum)(?:[_^](?:\{[^{}]*\}|\w))*)", r"\1\,", math)  # matplotlib leaves no space here,
    math = re.sub(r"(?<=[\w})])\s*(\\(?:sin|cos|tan|cot|max|min|arccos)\b)", r"\,\1", math)  # nor here
    with matplotlib.rc_context({"mathtext.fontset": "stix"}):
        font = FontProperties(size=SIZE)
        width, height, depth, *_ = MathTextParser("path").parse(f"${math}$", 72, font)
        outline = TextPath((0, 0), f"${math}$", size=SIZE, prop=font)
    drawn = "".join(
        LETTERS[Outline.code_type(code)] + " ".join(f"{value:.2f}" for value in points if code != Outline.CLOSEPOLY)
        for points, code in outline.iter_segments(simplify=False, curves=True)
    )
    pad = 0.5
    box = f"{-pad} {-(height - depth) - pad} {width + 2 * pad} {height + 2 * pad}"
    size = f"height:{(height + 2 * pad) / EM:.3f}em;vertical-align:{-(depth + pad) / EM:.3f}em"
    label = escape(tex, quote=True).replace("*", "&#42;").replace("_", "&#95;").replace("|", "&#124;")
    return (
        f'<svg class="math" role="img" aria-label="{label}" viewBox="{box}" style="{size}">'
        f'<path transform="scale(1,-1)" d="{drawn}"/></svg>'
    )


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn references in docstrings into links, if the page has what they name."""

    def reference(found: re.Match[str]) -> str:
        name = found[1]
        for anchor in (name, f"lightdome.{name}"):
            if f'id="{anchor}"' in html:
                return f'<a href="#{anchor}"><code>{name}</code></a>'
        return f"<code>{name}</code>"

    return re.sub(r":(?:attr|class|data|func|meth|mod):<code>([^<]+)</code>", reference, html)
