"""Python imports this at start where its folder is on PYTHONPATH: one module is then read from another file."""

import importlib.util
import os
import sys

MODULE, SOURCE = os.environ.get("MUTANT_MODULE"), os.environ.get("MUTANT_SOURCE")


class Mutation:
    """Finder of the changed module, before all others; child processes have it too."""

    def find_spec(self, name, path=None, target=None):
        """Return the place of the module with the code of the changed file."""
        if name != MODULE:
            return None
        sys.meta_path.remove(self)
        try:
            found = importlib.util.find_spec(name)
        finally:
            sys.meta_path.insert(0, self)
        with open(SOURCE, encoding="utf-8") as file:
            code = compile(file.read(), found.origin, "exec")
        found.loader.get_code = lambda fullname: code
        return found


if MODULE and SOURCE:
    sys.meta_path.insert(0, Mutation())
