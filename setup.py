"""Lets an editable install win over a folder called `lightdome`, as a clone is; setup.cfg has everything else.

The package lies in a folder of another name, so setuptools finds it by a hook that Python asks last. From the folder
that holds the clone, and from a script there, `import lightdome` would find the clone's folder before it, as a package
without content. So the editable wheel gets one line more, run when Python starts, that has the hook asked first.

A wheel has of data/ the default map alone, and not the program that makes it.
"""

from __future__ import annotations

import zipfile
from base64 import urlsafe_b64encode
from hashlib import sha256
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.editable_wheel import editable_wheel

# Files .pth are read in the order of their names: this one after setuptools' own, `__editable__.lightdome-VERSION.pth`.
NAME = "lightdome_first.pth"
HOOK = "__editable___lightdome_"  # how the name of its module begins
LINE = f'import sys; sys.meta_path.sort(key=lambda f: not getattr(f, "__module__", "").startswith("{HOOK}"))\n'.encode()


class EditableFirst(editable_wheel):
    """The editable wheel of setuptools, with that line."""

    def run(self) -> None:
        """Make the wheel, and write it again with the line and its entry in the list of files."""
        super().run()
        (path,) = Path(self.dist_dir).glob("*.whl")
        with zipfile.ZipFile(path) as wheel:
            files = {name: wheel.read(name) for name in wheel.namelist()}
        (record,) = (name for name in files if name.endswith(".dist-info/RECORD"))
        digest = urlsafe_b64encode(sha256(LINE).digest()).decode().rstrip("=")
        files[record] += f"{NAME},sha256={digest},{len(LINE)}\n".encode()
        files[NAME] = LINE
        with zipfile.ZipFile(path, "w") as wheel:
            for name, content in files.items():
                wheel.writestr(name, content)


class DataWithoutProgram(build_py):
    """The modules of all packages, of which `lightdome.data` has none."""

    def find_package_modules(self, package: str, package_dir: str) -> list[tuple[str, str, str]]:
        """The modules of ``package``."""
        return [] if package == "lightdome.data" else super().find_package_modules(package, package_dir)


setup(cmdclass={"build_py": DataWithoutProgram, "editable_wheel": EditableFirst})
