"""What the pages need to become a site, beyond Markdown: formulas, pages from the clone's top folder, references.

MkDocs calls these functions (``mkdocs.yml``). On GitHub the same pages need none of them.
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

# In the clone, on the site.
TOP = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "data/README.md": "maps.md",
}
SIZE, EM = 10, 9  # of a letter, and what stands for 1 em of the text, whose letters are wider
LETTERS = {Outline.MOVETO: "M", Outline.LINETO: "L", Outline.CURVE3: "Q", Outline.CURVE4: "C", Outline.CLOSEPOLY: "Z"}
CODE = r"^ *```(?!math).*?^ *```$|`[^`\n]+`"  # left as it is


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie outside of docs/."""
    for there, here in TOP.items():
        files.append(File.generated(config, here, abs_src_path=str(Path(config.config_file_path).parent / there)))
    return files


def on_page_markdown(text: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links between both folders to the site's pages, and draw formulas."""
    for there, here in TOP.items():
        text = re.sub(rf"\]\((?:\.\./)?{there}", f"]({here}", text)
    if page.file.src_uri in TOP.values():
        text = re.sub(r"\]\((?:\.\./)?docs/", "](", text)
    return re.sub(rf"{CODE}|^```math\n(.*?)^```$|\$([^$\n]+)\$|\]\[", shown, text, flags=re.MULTILINE | re.DOTALL)


def shown(found: re.Match[str]) -> str:
    """The picture of a formula; brackets as text, since no link here is by reference; code as it is."""
    display, inline = found.groups()
    if display:
        return f'<div class="formula">{picture(" ".join(display.split()), displayed=True)}</div>'
    if inline:
        return picture(inline, displayed=False)
    return "]&#91;" if found[0] == "][" else found[0]


def picture(tex: str, displayed: bool) -> str:
    """A formula as SVG that stands on the line of the text and has its colour."""
    math = tex.replace(r"\bmod", r"\;\mathrm{mod}\;").replace(r"\frac", r"\dfrac" if displayed else r"\frac")
    math = re.sub(r"(\\(?:int|sum)(?:[_^](?:\{[^{}]*\}|\w))*)", r"\1\,", math)  # matplotlib leaves no space there,
    math = re.sub(r"(?<=[\w})])\s*(\\(?:sin|cos|tan|cot|max|min|arccos)\b)", r"\,\1", math)  # nor there
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
    """Make references in docstrings links where the page has what they name."""

    def reference(found: re.Match[str]) -> str:
        name = found[1]
        for anchor in (name, f"lightdome.{name}"):
            if f'id="{anchor}"' in html:
                return f'<a href="#{anchor}"><code>{name}</code></a>'
        return f"<code>{name}</code>"

    return re.sub(r":(?:attr|class|data|func|meth|mod):<code>([^<]+)</code>", reference, html)
