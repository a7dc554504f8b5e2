"""Which channels of an OpenEXR file are the map: by their names, over all parts, never by their position.

A channel's full name is its layer's name, a dot, and its own name (``diffuse.R``). Without a dot it belongs to the
default layer. The map is the first of these that exists:

1. R, G and B of the default layer, or its Y, RY and BY, which are luminance and chroma
2. Y of the default layer, as grey
3. the only other layer with R, G and B (or Y, RY and BY)
4. the only other layer with Y

In a file of several parts, each part has a default layer, which goes by the part's name. If several layers remain, the
one called ``Combined``, ``rgba``, ``beauty`` or similar is taken. Three kinds are taken only on request: layers whose
names say that they hold no light (depth, albedo, normals, ambient occlusion, ...), views other than the first in
``multiView``, and deep parts. If the choice is still not unique, the file is refused.

R, G and B may be in lower case, or ``red``, ``green``, ``blue``. X, Y and Z do not count as colour, and neither do two
of R, G and B: a file is more likely to have lost a channel than to be made with two.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import LightdomeError, one_line, quoted

LISTED_CHANNELS, LISTED_CHARACTERS = 8, 240
RGB = ("R", "G", "B")
RGB_IN_ANY_CASE = (("r", "g", "b"), ("red", "green", "blue"))
CHROMA = ("y", "ry", "by")
MAIN = re.compile("combined|rgba?|beauty|colou?r|ci?|main|master|default|image|final|composite", re.IGNORECASE)
NO_LIGHT = re.compile(
    "("
    "(z|w)?depth|z|pz|deepz|z?buffer|distance|coc|height|displacement|bump|cavity|curvature"
    "|(ss|hb|gt)?ao|amb(ient)?occ|(ambient)?occlusion|shadow|a(lpha)?|opacity|masks?|mattes?"
    "|albedo|(diff|gloss|trans|subsurface)col|(diffuse|glossy|transmission|subsurface|base|vertex)colou?r|filter"
    "|roughness|metal(lic|ness)?|fresnel|facing|dotproduct|heat|wireframe|debug|variance|sample(s|r|count|rate|info)?"
    "|normals?|nrm|n[gs]?|[pn]ref|(bi|bitan)?tangents?|binormals?|pos(ition)?|p(world)?|uvs?|st|tex(ture)?coords?"
    "|(motion)?vectors?|motion|velocity|speed|mist"
    "|(object|material)?ids?|index(ob|ma)|crypto(matte|object|material|asset)?"
    ")(map|pass)?",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Part:
    """The header entries of a part that matter: ``views`` is ``multiView``, ``view`` is the part's own."""

    name: str
    channels: Sequence[str]
    view: str = ""
    views: Sequence[str] = ()
    deep: bool = False


@dataclass(frozen=True)
class Layer:
    """The channels of one layer in one part, and what their names say.

    - ``label``: its full name, which no other layer has
    - ``channels``: their positions in the part, by the channels' own names
    - ``colour``: the positions of R, G and B, or of Y, RY and BY if ``is_chroma``; ``grey``: the position of Y. Empty
      if it has none
    - ``short_name``: its name without those of enclosing layers and without its view
    """

    part: int
    label: str
    names: tuple[str, ...]
    short_name: str
    channels: Mapping[str, int]
    colour: tuple[int, ...]
    is_chroma: bool
    grey: tuple[int, ...]
    is_default: bool
    is_other_view: bool
    has_no_light: bool
    is_deep: bool

    @property
    def is_main(self) -> bool:
        """Whether its name is a usual one for the image itself."""
        return bool(MAIN.fullmatch(self.short_name))


def choose_layer(path: Path, parts: Sequence[Part], wanted: str | None) -> Layer:
    """The layer of a file that is the map, or that ``wanted`` names.

    Raises :class:`LightdomeError`, which lists the layers, if there is no such layer or the choice is not unique.
    """
    layers = find_layers(parts)
    if wanted is None:
        candidates = [layer for layer in layers if not (layer.has_no_light or layer.is_other_view)]
    else:
        candidates = _named(layers, wanted)
        if not candidates:
            raise LightdomeError(f"{path}: there is no layer {quoted(wanted)}; {_listed(layers)}")
    found = _by_the_rule([layer for layer in candidates if not layer.is_deep], len(parts) > 1)
    if len(found) == 1:
        return found[0]
    if found:
        labels = _joined([quoted(layer.label) for layer in found])
        raise LightdomeError(f"{path}: {len(found)} layers could be the map: {labels}; choose one with --layer NAME")
    if any(layer.is_deep for layer in candidates):
        raise LightdomeError(f"{path} is a deep image, which cannot be an environment map; flatten it")
    where = "it" if wanted is None else f"its layer {quoted(wanted)}"
    usable = any((layer.colour or layer.grey) and not layer.is_deep for layer in layers)
    advice = "; choose a layer with --layer NAME" if usable else ""
    raise LightdomeError(f"{path}: {where} has no R, G and B, and no Y, to be the map; {_listed(layers)}{advice}")


def _by_the_rule(layers: Sequence[Layer], several_parts: bool) -> list[Layer]:
    """The layer that is the map, or all layers that could be, or none."""
    main = [layer for layer in layers if layer.is_main and layer.colour and not layer.is_default]
    for is_default in (True, False):
        for places in ("colour", "grey"):
            found = [layer for layer in layers if layer.is_default == is_default and getattr(layer, places)]
            if found and is_default and several_parts:
                found += main  # a layer "beauty" is as likely the map as the default layer of a part "diffuse"
            best = [layer for layer in found if not layer.short_name] or [layer for layer in found if layer.is_main]
            if found:
                return best if len(best) == 1 else found
    return []


def find_layers(parts: Sequence[Part]) -> list[Layer]:
    """All layers of all parts, in the file's order."""
    views = next((part.views for part in parts if part.views), ())
    grouped = [(number, *group) for number, part in enumerate(parts) for group in _grouped(part).items()]
    labels = [_label(parts[number].name if len(parts) > 1 else "", name) for number, name, _ in grouped]
    how_many = Counter(labels)
    result = []
    for (number, name, channels), label in zip(grouped, labels, strict=True):
        part = parts[number]
        known_views = {*views, part.view} - {""}
        inner, view = _without_view(name, known_views)
        outer, _ = _without_view(part.name if len(parts) > 1 else "", known_views)
        lower: dict[str, int] = {}
        for own, place in channels.items():
            lower.setdefault(own.lower(), place)
        colours = [(channels, RGB), *((lower, names) for names in (*RGB_IN_ANY_CASE, CHROMA))]
        colour = next((tuple(of[name] for name in names) for of, names in colours if of.keys() >= set(names)), ())
        is_grey = "y" in lower and not {"x", "ry", "by"} & lower.keys()
        result.append(
            Layer(
                part=number,
                label=label if how_many[label] == 1 else f"{label}#{number + 1}",
                names=(name, part.name),
                short_name=(inner or outer or [""])[-1],
                channels=channels,
                colour=colour,
                is_chroma=bool(colour) and colour == tuple(lower.get(n) for n in CHROMA),
                grey=(lower["y"],) if is_grey else (),
                is_default=not inner,
                is_other_view=bool(views) and (part.view or view or views[0]) != views[0],
                has_no_light=any(_means_no_light(names[-1]) for names in (inner, outer) if names),
                is_deep=part.deep,
            )
        )
    return result


def _grouped(part: Part) -> dict[str, dict[str, int]]:
    """For each layer, the positions of its channels by the channels' own names."""
    result: dict[str, dict[str, int]] = {}
    for place, channel in enumerate(part.channels):
        layer, _, own = channel.rpartition(".")
        result.setdefault(layer, {}).setdefault(own, place)
    return result


def _label(part: str, layer: str) -> str:
    return f"{part}.{layer}" if part and layer and part != layer else part or layer


def _without_view(name: str, views: set[str]) -> tuple[list[str], str]:
    """The names, outermost first, that make up the full name of a layer or part, and the view at its end."""
    names = [word for word in name.split(".") if word]
    view = names.pop() if names and names[-1] in views else ""
    return names, view


def _means_no_light(name: str) -> bool:
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    # Single letters count only as the whole name: "key A" is not alpha, and neither is "a1".
    words = [word for word in (*words, "".join(words)) if len(word) > 1] or [name]
    return any(NO_LIGHT.fullmatch(word) for word in words)


def _named(layers: Sequence[Layer], wanted: str) -> list[Layer]:
    """The layers that ``wanted`` may mean: by label, by the name of layer or part, or by the last word of it."""
    ways = (
        lambda layer: layer.label == wanted,
        lambda layer: wanted in layer.names,
        lambda layer: wanted.lower() in (name.lower() for name in (layer.label, *layer.names)),
        lambda layer: wanted.lower() == layer.short_name.lower(),
    )
    return next((found for way in ways if (found := [layer for layer in layers if way(layer)])), [])


def _listed(layers: Sequence[Layer]) -> str:
    entries = []
    for layer in layers:
        channels = ", ".join(list(layer.channels)[:LISTED_CHANNELS])
        channels += ", ..." if len(layer.channels) > LISTED_CHANNELS else ""
        entries.append(one_line(f"{layer.label} ({channels})" if layer.label else channels))
    return f"the file holds {_joined(entries)}"


def _joined(entries: Sequence[str]) -> str:
    """As many entries as fit in a message."""
    shown = list(entries[:LISTED_CHARACTERS])
    while len("; ".join(shown)) > LISTED_CHARACTERS and len(shown) > 1:
        del shown[-1]
    more = f"; and {len(entries) - len(shown)} more" if len(shown) < len(entries) else ""
    return "; ".join(shown) + more
