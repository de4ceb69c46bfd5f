"""How many examples properties are tried on: few and always the same in CI, many new ones on demand.

`pytest tests/properties --hypothesis-profile=long` tries thirty times as many, new ones in each run.
"""

import pytest
from hypothesis import HealthCheck, Phase, settings

# What explains a failure takes as long as finding it.
settings.register_profile(
    "quick",
    max_examples=30,
    derandomize=True,
    deadline=None,
    database=None,
    phases=(Phase.explicit, Phase.generate, Phase.shrink),
)
settings.register_profile(
    "long",
    max_examples=1000,
    deadline=None,
    database=None,
    print_blob=True,
    phases=(Phase.explicit, Phase.generate, Phase.shrink),
    suppress_health_check=(HealthCheck.too_slow,),
)


def pytest_configure(config: pytest.Config) -> None:
    """The quick profile, if no other is asked for."""
    if not config.getoption("--hypothesis-profile"):
        settings.load_profile("quick")
