#!/usr/bin/env python3
"""Build the API reference from the docstrings: docs/api.py [FOLDER], by default out/api; needs the extra [docs]."""

import pkgutil
import sys
import warnings
from pathlib import Path

import lightdome
import pdoc

warnings.simplefilter("error")
for name in lightdome.__all__:  # pdoc sees only what was loaded
    setattr(lightdome, name, getattr(lightdome, name))
modules = [f"lightdome.{module.name}" for module in pkgutil.iter_modules(lightdome.__path__)]  # packages with theirs

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/api")
pdoc.render.configure(docformat="restructuredtext")
pdoc.pdoc("lightdome", *sorted(modules), output_directory=folder)
print(f"wrote {folder}; look first at {folder / 'lightdome.html'}")
