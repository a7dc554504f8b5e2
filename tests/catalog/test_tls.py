"""A catalog computed over TLS: only those who hold certificates of the same authority reach the cluster."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers import Script, stiff_radiance
from lightdome.maps.images import write_image

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

from distributed import LocalCluster
from lightdome.catalog import cluster
from lightdome.catalog.cluster import Place, connected

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl, which makes the certificates"),
]
Certificates = tuple[Path, Path, Path]


def issued(folder: Path) -> Certificates:
    """An authority, and a certificate and key of its own, as --tls takes them."""

    def openssl(*words: object) -> None:
        subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True)

    folder.mkdir()
    ca, certificate, key, request = (folder / name for name in ("ca.pem", "cert.pem", "key.pem", "request.pem"))
    new = ("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
    openssl(*new, "-x509", "-days", 1, "-subj", f"/CN={folder.name}", "-keyout", folder / "ca.key", "-out", ca)
    openssl(*new, "-subj", "/CN=worker", "-keyout", key, "-out", request)
    signed_by = ("-CA", ca, "-CAkey", folder / "ca.key", "-set_serial", 1)
    openssl("x509", "-req", "-in", request, *signed_by, "-days", 1, "-out", certificate)
    return ca, certificate, key


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return issued(tmp_path_factory.mktemp("tls") / "ours")


@pytest.fixture(scope="module")
def theirs(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return issued(tmp_path_factory.mktemp("tls") / "theirs")


@pytest.fixture(scope="module")
def address(ours: Certificates) -> Iterator[str]:
    """The address of a scheduler on loopback, with a worker."""
    security = Place(1, 1, 1 << 30, tls=ours).security
    with LocalCluster(
        processes=False, n_workers=1, threads_per_worker=2, protocol="tls", host="127.0.0.1", security=security,
        dashboard_address="127.0.0.1:0",
    ) as local:  # fmt: skip
        yield local.scheduler_address


def test_a_catalog_is_computed_over_tls(address: str, ours: Certificates, tmp_path: Path, run_here: Script) -> None:
    write_image(tmp_path / "map.exr", stiff_radiance(8, 16))
    (tmp_path / "scheduler.json").write_text(json.dumps({"address": address}))
    for place in (("--scheduler", address), ("--scheduler-file", tmp_path / "scheduler.json")):
        out = tmp_path / place[0]
        result = run_here("catalog", tmp_path / "map.exr", "--out", out, *place, "--tls", *ours)
        assert result.returncode == 0, result.stderr
        assert "1 map: 1 computed, 0 already known, 0 failed" in result.stdout


@pytest.mark.filterwarnings("ignore:unclosed")
def test_whoever_lacks_the_certificates_is_refused_in_one_line(
    address: str, ours: Certificates, theirs: Certificates, tmp_path: Path, run_here: Script
) -> None:
    write_image(tmp_path / "map.exr", stiff_radiance(8, 16))
    (tmp_path / "scheduler.json").write_text(json.dumps({"address": address}))
    plain = address.replace("tls://", "tcp://")
    mixed = (ours[0], *theirs[1:])
    for place, words in {
        ("--scheduler", address): "needs --tls",
        ("--scheduler-file", tmp_path / "scheduler.json"): "needs --tls",
        ("--scheduler", plain): "cannot connect to a Dask scheduler",
        ("--scheduler", plain, "--tls", *ours): "--tls needs a Dask scheduler at tls://",
        ("--scheduler", address, "--tls", *theirs): "certificate",
        ("--scheduler", address, "--tls", *mixed): "cannot connect to a Dask scheduler",
        ("--scheduler", address, "--tls", *[ours[2]] * 3): "cannot connect to a Dask scheduler",
        ("--scheduler", address, "--tls", *ours[:2], "none.pem"): "cannot read none.pem",
    }.items():
        result = run_here("catalog", tmp_path / "map.exr", "--out", tmp_path / "out", *place)
        assert result.returncode == 1
        assert words in result.stderr
        assert result.stderr.count("\n") == 1, result.stderr


def test_a_scheduler_file_that_does_not_appear_is_given_up(
    tmp_path: Path, run_here: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "PATIENCE", 0.1)
    write_image(tmp_path / "map.exr", stiff_radiance(8, 16))
    (tmp_path / "empty.json").write_text("{}")
    for name in ("none.json", "empty.json"):
        place = ("--scheduler-file", tmp_path / name)
        result = run_here("catalog", tmp_path / "map.exr", "--out", tmp_path / "out", *place)
        assert result.returncode == 1
        assert "cannot read the scheduler file" in result.stderr


def test_our_own_cluster_uses_tls_too_on_loopback_and_the_threads_that_it_may(
    ours: Certificates, tmp_path: Path
) -> None:
    with connected(Place(workers=1, threads=3, memory=1 << 30, tls=ours), str(tmp_path)) as client:
        assert client.scheduler.address.startswith("tls://127.0.0.1:")
        assert client.dashboard_link.startswith("http://127.0.0.1:")
        assert client.submit(os.getenv, "POCL_MAX_PTHREAD_COUNT").result() == "3"
