"""What `import lightdome` gives: every module and every public name, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import lightdome
import pytest
from helpers import LONG, ROOT

pytestmark = pytest.mark.slow

MODULES = sorted(
    path.stem
    for path in (ROOT / "pyhost").iterdir()
    if not path.stem.startswith("_") and (path.suffix == ".py" or (path / "__init__.py").exists())
)


def python(program: str, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *options, "-c", program], capture_output=True, text=True, timeout=LONG)


def test_every_module_is_an_attribute_of_the_package() -> None:
    result = python(f"import lightdome\nfor name in {MODULES!r}: assert getattr(lightdome, name).__doc__, name")
    assert result.returncode == 0, result.stderr
    assert set(MODULES) | set(lightdome.__all__) == set(dir(lightdome))


def test_importing_the_package_loads_nothing() -> None:
    result = python("import sys, lightdome; print(*sorted(m for m in sys.modules if m.startswith('lightdome.')))")
    assert result.stdout.strip() == "", result.stderr


@pytest.mark.parametrize("name", ["exakt", "_home", "render_"])
def test_there_is_no_other_attribute(name: str) -> None:
    assert not hasattr(lightdome, name)


def test_a_type_checker_knows_every_module_and_no_wrong_name(tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="needs mypy, of the extra [dev]")
    (tmp_path / "lightdome").symlink_to(ROOT / "pyhost")
    lines = ["import lightdome", *(f"lightdome.{name}" for name in (*MODULES, *lightdome.__all__)), "lightdome.exakt"]
    (tmp_path / "program.py").write_text("\n".join(lines))
    result = subprocess.run(
        [sys.executable, "-m", "mypy", "--follow-imports=silent", "--no-incremental", "--strict", "program.py"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=LONG,
    )
    found = [line for line in result.stdout.splitlines() if line.startswith("program.py")]
    assert len(found) == 1, result.stdout + result.stderr
    assert found[0].startswith(f"program.py:{len(lines)}:")
    assert "exakt" in found[0]
