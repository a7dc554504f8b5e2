"""Maps and a cluster that the tests of a catalog share."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import progress
from lightdome.maps import convert
from lightdome.maps.images import write_image

if TYPE_CHECKING:
    from distributed import Client


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Maps of several kinds, two of them damaged. Tests that change them use ``maps``."""
    folder = tmp_path_factory.mktemp("library") / "maps"
    (folder / "below").mkdir(parents=True)
    for n in range(6):
        write_image(folder / f"m{n}.{'exr' if n % 2 else 'pfm'}", stiff_radiance(8, 16, n))
    write_image(folder / "below" / "probe.exr", convert(stiff_radiance(32, 64), "latlong", "angular", 32))
    write_image(folder / "black.pfm", np.zeros((8, 16, 3), np.float32))
    bad = stiff_radiance(8, 16)
    bad[3, 4], bad[5, 6] = np.nan, np.inf
    write_image(folder / "nan.exr", bad)
    (folder / "cut.exr").write_bytes((folder / "m1.exr").read_bytes()[:200])
    (folder / ".hidden.exr").write_bytes(b"")
    (folder / "none.hdr").write_bytes(b"#?")
    return folder


@pytest.fixture
def maps(library: Path, tmp_path: Path) -> Path:
    """A copy of ``library``."""
    return shutil.copytree(library, tmp_path / "maps")


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    """A client of a cluster in this process, which stays silent only while it is a worker."""
    distributed = pytest.importorskip("distributed")
    with (
        pytest.MonkeyPatch.context() as patch,
        distributed.LocalCluster(
            processes=False, n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        patch.setattr(progress, "LINE_PATIENCE", progress.LINE_PATIENCE)
        yield client
