"""Python imports this at start where its folder is on PYTHONPATH: one module is then read from another file."""

import os
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import find_spec, spec_from_file_location

MODULE, SOURCE = os.environ.get("MUTANT_MODULE"), os.environ.get("MUTANT_SOURCE")


class Changed(SourceFileLoader):
    """Loader of a module at its place, with the code of the changed file."""

    def get_code(self, fullname):
        """Return the code of the changed file."""
        with open(SOURCE, encoding="utf-8") as file:
            return compile(file.read(), self.path, "exec")


class Mutation:
    """Finder of the changed module, before all others; child processes have it too."""

    def find_spec(self, name, path=None, target=None):
        """Return the place of the module with its other loader."""
        if name != MODULE:
            return None
        sys.meta_path.remove(self)
        try:
            found = find_spec(name)
        finally:
            sys.meta_path.insert(0, self)
        loader, inside = Changed(name, found.origin), found.submodule_search_locations
        return spec_from_file_location(name, found.origin, loader=loader, submodule_search_locations=inside)


if MODULE and SOURCE:
    sys.meta_path.insert(0, Mutation())
