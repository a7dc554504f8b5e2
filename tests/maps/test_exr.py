"""The channels of an EXR file are chosen by their names, over all parts, and keep their values."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from exr_bytes import Part, exr_file, planes
from helpers import CHROMA_IS_HIDDEN, Script, fails_in_one_line
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, read_image

HEIGHT, WIDTH = 4, 8
MAP = np.random.default_rng(1).integers(1, 64, (HEIGHT, WIDTH, 3)).astype(np.float32) / 4  # exact in half
OTHER = MAP[::-1] + 20
GREY = MAP[..., 0]


def grey_of(plane: np.ndarray) -> np.ndarray:
    return np.repeat(plane[..., None], 3, axis=2)


def written(tmp_path: Path, *parts: Part) -> Path:
    (tmp_path / "map.exr").write_bytes(exr_file(*parts))
    return tmp_path / "map.exr"


def layers(**names: np.ndarray) -> Part:
    """One part with R, G, B (or Y, for a plane) in each layer."""
    channels = {}
    for name, pixels in names.items():
        layer = name.replace("__", ".")
        channels |= planes(pixels, layer=layer) if pixels.ndim == 3 else planes(pixels[..., None], "Y", layer)
    return Part(channels)


def views(*names: str) -> dict[str, tuple[str, bytes]]:
    text = b"".join(struct.pack("<i", len(name)) + name.encode() for name in names)
    return {"multiView": ("stringvector", text)}


def view(name: str) -> dict[str, tuple[str, bytes]]:
    return {"view": ("string", name.encode())}


OTHERS = planes(OTHER)
DEPTH = {"Z": GREY.astype(np.float32)}
CHOSEN = {
    "the default layer, whatever stands before it": [Part({**planes(MAP), **planes(OTHER, layer="A"), **DEPTH})],
    "the default layer, although another is called beauty": [Part({**planes(MAP), **planes(OTHER, layer="beauty")})],
    "lower case": [Part({**planes(MAP, "rgb"), "a": GREY.astype(np.float16)})],
    "mixed case": [Part(planes(MAP, "RgB"))],
    "words": [Part({f"diffuse.{n}": p for n, p in zip(("red", "Green", "BLUE"), planes(MAP).values(), strict=True)})],
    "upper case before lower": [Part({**planes(MAP), **planes(OTHER, "rgb")})],
    "the only colour layer": [Part({**planes(MAP, layer="left"), "left.Z": DEPTH["Z"], "N.X": GREY.astype("f2")})],
    "combined": [layers(AO=OTHER, View__Combined=MAP, View__Diffuse=OTHER)],
    "rgba": [layers(a=OTHER, b=OTHER, RGBA=MAP)],
    "what holds no light is left out": [layers(albedo=OTHER, Denoising_Normal=OTHER, key=MAP, ambientOcclusion=OTHER)],
    "alpha and depth do not matter": [Part({"A": GREY.astype(np.float16), **planes(MAP), **DEPTH})],
    "the default view": [Part({**planes(MAP), **planes(OTHER, layer="left")}, attributes=views("right", "left"))],
    "the default view, by name": [
        Part({**planes(MAP, layer="right"), **planes(OTHER, layer="left")}, attributes=views("right", "left"))
    ],
    "the default view of a layer": [
        Part(
            {**planes(OTHER, layer="Main.Combined.l"), **planes(MAP, layer="Main.Combined.r")},
            attributes=views("r", "l"),
        )
    ],
    "the second part": [Part(DEPTH, "depth"), Part(planes(MAP), "rgb"), Part(planes(OTHER), "normals")],
    "the part beauty": [Part(OTHERS, "diffuse"), Part(OTHERS, "specular"), Part(planes(MAP), "beauty")],
    "a layer beauty in another part": [Part(OTHERS, "diffuse"), Part(planes(MAP, layer="beauty"), "all")],
    "a part and its layer of one name": [Part(DEPTH, "depth"), Part(planes(MAP, layer="key"), "key")],
    "letters in a name": [layers(Key_A=MAP, Z=OTHER, Pworld=OTHER)],
    "parts of other sizes": [Part(planes(OTHER[:2, :4]), "matte", display=(0, 0, 7, 3)), Part(planes(MAP), "x")],
    "a flat part beside a deep one": [Part(OTHERS, "rgba", deep=True), Part(planes(MAP), "flat")],
    "the part of the first view": [
        Part(OTHERS, "c.left", view("left") | views("right", "left")),
        Part(planes(MAP), "c.right", view("right")),
    ],
    "pixels that are not square": [Part(planes(MAP), attributes={"pixelAspectRatio": ("float", struct.pack("<f", 2))})],
    "all number types at once": [
        Part({"R": MAP[..., 0].astype(np.float32), **planes(MAP[..., 1:2], "G"), **planes(MAP[..., 2:], "B")})
    ],
}


@pytest.mark.parametrize("case", CHOSEN)
def test_the_map_is_found_by_name(tmp_path: Path, case: str) -> None:
    path = written(tmp_path, *CHOSEN[case])
    np.testing.assert_array_equal(read_image(path), MAP)
    rows = ImageRows(path, batch=3)
    np.testing.assert_array_equal(np.concatenate([pixels for _, pixels in rows.read(np.arange(HEIGHT))]), MAP)


@pytest.mark.parametrize(
    "part",
    [
        Part({"Y": GREY.astype(np.float16), **planes(OTHER, layer="aux")}),
        Part({"Y": GREY.astype(np.float16), "A": GREY.astype(np.float16), **DEPTH}),
        Part({"Y": GREY.astype(np.float32)}),
        layers(luminance=GREY),
        layers(depth=GREY + 1, key=GREY),
    ],
)
def test_y_is_grey(tmp_path: Path, part: Part) -> None:
    np.testing.assert_array_equal(read_image(written(tmp_path, part)), grey_of(GREY))


REFUSED = {
    "X, Y and Z": ([Part(planes(MAP, "XYZ"))], "no R, G and B.*X, Y, Z"),
    "X and Y": ([Part(planes(MAP[..., :2], "XY"))], "no R, G and B"),
    "a lone depth": ([Part(DEPTH)], "no R, G and B.*the file holds Z"),
    "a lone alpha": ([Part({"A": GREY.astype(np.float16)})], "no R, G and B.*the file holds A"),
    "a lone red": ([Part({"R": GREY.astype(np.float16)})], "no R, G and B.*the file holds R"),
    "red and blue": ([Part(planes(MAP[..., :2], "RB"))], "no R, G and B"),
    "normals": ([Part(planes(MAP, "XYZ", "N"))], r"no R, G and B.*N \(X, Y, Z\)"),
    "only an albedo": ([layers(albedo=MAP)], r"albedo \(B, G, R\)|albedo \(R, G, B\).*--layer"),
    "luminance with one chroma": ([Part({"Y": GREY.astype("f2"), "RY": GREY.astype("f2")})], "no R, G and B"),
    "two layers": ([layers(key=MAP, fill=OTHER)], "2 layers could be.*'fill'; 'key'.*--layer"),
    "two combined": ([layers(a__Combined=MAP, b__Combined=OTHER)], "'a.Combined'; 'b.Combined'"),
    "two views and no default": ([layers(left=MAP, right=OTHER)], "'left'; 'right'"),
    "two parts": ([Part(planes(MAP), "one"), Part(OTHERS, "two")], "'one'; 'two'"),
    "two views in parts": (
        [Part(planes(MAP), "rgba.left", view("left")), Part(OTHERS, "rgba.right", view("right"))],
        "'rgba.left'; 'rgba.right'",
    ),
    "deep parts only": ([Part(OTHERS, "a", deep=True), Part(DEPTH, "b", deep=True)], "deep image"),
    "the map's part is cropped": (
        [Part(DEPTH, "z", display=(0, 0, 9, 9)), Part(OTHERS, "c", display=(0, 0, 9, 9))],
        "uncropped",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_ambiguous_file_is_refused_with_a_list_of_its_layers(tmp_path: Path, case: str) -> None:
    parts, reason = REFUSED[case]
    with pytest.raises(LightdomeError, match=reason) as error:
        read_image(written(tmp_path, *parts))
    assert "sanitize" not in str(error.value)


TWO_PARTS = [
    Part({**planes(OTHER, layer="a"), **planes(MAP, layer="b")}, "left"),
    Part({**planes(OTHER, layer="a"), **planes(OTHER, layer="b"), **planes(MAP, layer="own")}, "right"),
]


@pytest.mark.parametrize(
    ("parts", "layer"),
    [
        ([layers(key=MAP, fill=OTHER)], "key"),
        ([layers(key=MAP, fill=OTHER)], "KEY"),
        ([layers(a__Combined=MAP, b__Combined=OTHER)], "a.Combined"),
        ([layers(a__key=MAP, b__fill=OTHER)], "key"),
        ([layers(albedo=MAP)], "albedo"),
        ([Part({**OTHERS, **planes(MAP, layer="aux")})], "aux"),
        ([Part({**OTHERS, **planes(MAP, layer="left")}, attributes=views("right", "left"))], "left"),
        ([Part(planes(MAP), "one"), Part(OTHERS, "two")], "one"),
        ([Part(planes(MAP), "one two.three"), Part(OTHERS, "two")], "one two.three"),
        ([Part({**planes(MAP), **planes(OTHER, layer="x")}, "one"), Part(OTHERS, "two")], "one"),
        (TWO_PARTS, "left.b"),
        ([Part(planes(OTHER, layer="fill"), "fill"), Part(planes(MAP, layer="key"), "key")], "key"),
        (TWO_PARTS, "own"),
        (TWO_PARTS, "right.own"),
    ],
)
def test_a_layer_is_taken_by_its_name_or_its_part_s(tmp_path: Path, parts: list[Part], layer: str) -> None:
    path = written(tmp_path, *parts)
    np.testing.assert_array_equal(read_image(path, layer=layer), MAP)
    np.testing.assert_array_equal(EnvironmentMap.read(path, layer=layer).radiance, MAP)
    np.testing.assert_array_equal(next(ImageRows(path, layer=layer).read(np.arange(HEIGHT)))[1], MAP)


def test_parts_of_the_same_name_are_told_apart_or_refused(tmp_path: Path) -> None:
    """The format forbids them, but not every OpenEXR that OpenImageIO comes with refuses them."""
    path = written(tmp_path, Part(OTHERS, "same"), Part(planes(MAP), "same"))
    if oiio.ImageInput.open(str(path)):
        np.testing.assert_array_equal(read_image(path, layer="same#2"), MAP)
    else:
        with pytest.raises(LightdomeError, match="not a unique name"):
            read_image(path, layer="same#2")


def test_a_missing_or_colourless_layer_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, Part({**planes(MAP), **planes(MAP, "XYZ", "N")}))
    with pytest.raises(LightdomeError, match=r"no layer 'beauty'; the file holds .*N \(X, Y, Z\)"):
        read_image(path, layer="beauty")
    with pytest.raises(LightdomeError, match="its layer 'N' has no R, G and B"):
        read_image(path, layer="N")
    with pytest.raises(LightdomeError, match=r"'left\.a'; 'right\.a'"):
        read_image(written(tmp_path, *TWO_PARTS), layer="a")
    (tmp_path / "map.pfm").write_bytes(b"Pf\n1 1\n-1\n\0\0\0\0")
    with pytest.raises(LightdomeError, match="leave out --layer"):
        read_image(tmp_path / "map.pfm", layer="a")


def test_the_names_of_layers_that_hold_no_light_are_known(tmp_path: Path) -> None:
    names = "Diffuse Color,TransCol,VRayDiffuseFilter,Opacity,SSAO,zbuffer,DeepZ,Pz,Nref,uvmap,depthmap,zpass,N,Z"
    for name in (*names.split(","), "samplerInfo", "CryptoAsset00", "world_position", "tangent", "heatmap"):
        with pytest.raises(LightdomeError, match=f"{name} .*; choose a layer with --layer NAME"):
            read_image(written(tmp_path, layers(**{name: MAP})))
    for name in ("a1", "p0", "Pass", "Glossy Direct", "key_A", "sky", "emission", "Env", "left", "RGBA_Diffuse"):
        np.testing.assert_array_equal(read_image(written(tmp_path, layers(**{name: MAP}))), MAP)


def test_a_name_is_quoted_as_it_is(tmp_path: Path) -> None:
    path = written(tmp_path, layers(key=MAP, fill=OTHER))
    for layer, quoted in (("no\nsuch", "'no\\\\nsuch'"), ("\ud800", "'\\\\ud800'"), (" ", "' '")):
        with pytest.raises(LightdomeError, match=f"no layer {quoted};") as error:
            read_image(path, layer)
        assert str(error.value).isprintable()


def test_many_parts_and_long_headers_cost_little_time(tmp_path: Path) -> None:
    parts = [Part({c: np.ones((1, 1), np.float16) for c in "RGB"}, f"light{n}") for n in range(3000)]
    attributes = {f"attribute{n:06}": ("int", bytes(4)) for n in range(10**5)}
    channels = b"".join(b"c%06d" % n + bytes(17) for n in range(10**5))
    start = time.perf_counter()
    with pytest.raises(LightdomeError, match="3000 layers could be the map"):
        read_image(written(tmp_path, *parts))
    with pytest.raises(LightdomeError, match="too many attributes or channels"):
        read_image(written(tmp_path, Part(planes(MAP), attributes=attributes)))
    with pytest.raises(LightdomeError, match="too many attributes or channels"):
        read_image(written(tmp_path, Part(planes(MAP), attributes={"channels": ("chlist", channels)})))
    with pytest.raises(LightdomeError, match="longer than 16 MiB"):
        read_image(written(tmp_path, Part(planes(MAP), attributes={"note": ("string", bytes(2**24))})))
    assert time.perf_counter() - start < 5


def test_many_layers_fit_into_a_message(tmp_path: Path) -> None:
    many = written(tmp_path, layers(**{f"{i}_{'x' * 100}": MAP for i in range(200)}))
    for layer in (None, "y"):
        with pytest.raises(LightdomeError, match=r"and 19[89] more") as error:
            read_image(many, layer)
        assert len(str(error.value)) - len(str(many)) < 400


def test_the_chosen_layer_is_reported(tmp_path: Path) -> None:
    assert "'key'" in EnvironmentMap.read(written(tmp_path, layers(key=MAP))).notes[0]
    assert EnvironmentMap.read(written(tmp_path, layers(key=MAP)), layer="key").notes == ()
    assert EnvironmentMap.read(written(tmp_path, Part(planes(MAP)))).notes == ()


def test_whole_numbers_are_read_as_they_are(tmp_path: Path) -> None:
    numbers = np.array([[0, 1, 255, 65536, 2**31, 2**32 - 1]], np.uint32)
    image = read_image(written(tmp_path, Part({"R": numbers, "G": numbers[:, ::-1], "B": numbers})))
    np.testing.assert_array_equal(image, np.stack([numbers, numbers[:, ::-1], numbers], axis=2).astype(np.float32))
    np.testing.assert_array_equal(
        read_image(written(tmp_path, Part({"Y": numbers}))), grey_of(numbers.astype(np.float32))
    )
    mixed = Part({"R": numbers, "G": numbers.astype(np.float32) / 2, "B": np.full((1, 6), 0.5, np.float16)})
    np.testing.assert_array_equal(
        read_image(written(tmp_path, mixed)),
        np.stack([numbers, numbers / 2, np.full((1, 6), 0.5)], axis=2).astype(np.float32),
    )


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_floats_keep_their_values(tmp_path: Path, kind: type) -> None:
    values = np.array([[0, -1, np.inf, -np.inf, np.nan, 65504, 6e-8]], kind)
    image = read_image(written(tmp_path, Part({"R": values, "G": values, "B": values})))
    np.testing.assert_array_equal(image, grey_of(values.astype(np.float32)))


PRIMARIES = {
    "rec709": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    "wide": (0.7, 0.3, 0.2, 0.7, 0.1, 0.1, 0.3, 0.32),
}


@pytest.mark.parametrize(("primaries", "layer"), [("rec709", ""), ("wide", ""), ("rec709", "beauty")])
def test_luminance_and_chroma_are_converted_by_the_file_s_chromaticities(
    tmp_path: Path, primaries: str, layer: str
) -> None:
    x, y = np.array(PRIMARIES[primaries], np.float64).reshape(4, 2).T
    columns = np.stack([x / y, np.ones(4), (1 - x - y) / y])  # XYZ of luminance 1
    weights = np.linalg.solve(columns[:, :3], columns[:, 3])
    luminance = MAP.astype(np.float64) @ weights
    chroma = [(MAP[..., c] - luminance) / luminance for c in (0, 2)]
    channels = np.stack([luminance, *chroma], axis=2)
    names = ("Y", "RY", "BY")
    prefix = f"{layer}." if layer else ""
    attributes = {"chromaticities": ("chromaticities", struct.pack("<8f", *PRIMARIES[primaries]))}
    part = Part(
        {prefix + name: channels[..., i].astype(np.float32) for i, name in enumerate(names)},
        attributes={} if primaries == "rec709" else attributes,
    )
    path = written(tmp_path, part)
    if CHROMA_IS_HIDDEN:
        with pytest.raises(LightdomeError, match="luminance-chroma"):
            read_image(path)
    else:
        np.testing.assert_allclose(read_image(path), MAP, rtol=1e-5, atol=1e-5)


@pytest.mark.skipif(CHROMA_IS_HIDDEN, reason="this OpenImageIO hides chroma")
def test_an_infinite_luminance_is_a_sun_without_a_hole_in_its_green(tmp_path: Path) -> None:
    channels = {name: np.full((1, 2), value, np.float16) for name, value in (("Y", np.inf), ("RY", -0.5), ("BY", 0.5))}
    path = written(tmp_path, Part(channels))
    np.testing.assert_array_equal(read_image(path), np.full((1, 2, 3), np.inf))
    np.testing.assert_array_equal(EnvironmentMap.read(path, sanitize="clamp").radiance, np.full((1, 2, 3), 65504))


def test_subsampled_chroma_is_refused_by_that_name(tmp_path: Path) -> None:
    small = np.zeros((HEIGHT // 2, WIDTH // 2), np.float16)
    with pytest.raises(LightdomeError, match=r"subsampled") as error:
        read_image(written(tmp_path, Part({"Y": GREY.astype(np.float16), "RY": small, "BY": small})))
    assert "luminance-chroma" in str(error.value)


def test_bad_chromaticities_are_refused(tmp_path: Path) -> None:
    bad = {"chromaticities": ("chromaticities", struct.pack("<8f", *[0.3] * 8))}
    with pytest.raises(LightdomeError, match=r"chromaticities|luminance-chroma"):
        read_image(written(tmp_path, Part({name: GREY.astype("f2") for name in ("Y", "RY", "BY")}, attributes=bad)))


def test_a_false_cube_map_is_refused_and_samples_on_the_border_are_reported(tmp_path: Path, run_here: Script) -> None:
    cube = written(tmp_path, Part(planes(MAP), attributes={"envmap": ("envmap", b"\1")}))
    with pytest.raises(LightdomeError, match=r"expected the sides of a cube-openexr map, 1:6"):
        EnvironmentMap.read(cube)
    np.testing.assert_array_equal(read_image(cube), MAP)
    latlong = written(tmp_path, Part(planes(MAP), attributes={"envmap": ("envmap", b"\0")}))
    np.testing.assert_array_equal(read_image(latlong), MAP)
    assert "border" in EnvironmentMap.read(latlong).notes[0]
    for more in ((), ("--samples-only",)):
        result = run_here("part2_sample", "--map", latlong, "--counts", 3, "--out", tmp_path / "out", *more)
        assert result.returncode == 0, result.stderr
        assert "envmap = latlong" in result.stderr


def test_scripts_take_the_layer_and_list_the_layers(tmp_path: Path, run_here: Script) -> None:
    path = written(tmp_path, layers(key=MAP, fill=OTHER))
    result = run_here("part2_sample", "--map", path, "--out", tmp_path / "out")
    fails_in_one_line(result, "'fill'; 'key'", "--layer NAME")
    for more in ((), ("--samples-only",)):
        options = ("--map", path, "--layer", "key", "--counts", 3, "--out", tmp_path / "out")
        assert run_here("part2_sample", *options, *more).returncode == 0
        with np.load(tmp_path / "out" / "samples_3.npz") as samples:
            x, y = samples["pixel"].T
            np.testing.assert_array_equal(samples["radiance"], MAP[y, x])
