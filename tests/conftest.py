"""Fixtures that several tests share."""

import gc
import os
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

from grasp_refine.collision.engine import VARIABLE, why_not_native

# One thread, as the commands take: of two processes of tests on two cores, each would wait for the other's threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")

SLOW_LIMIT_S = 1800
"""Seconds after which a test marked `slow` fails; those of others are in pyproject.toml."""

# Properties are tried on few examples, always the same; `pytest tests/properties --hypothesis-profile=long` tries many,
# new ones in each run. What explains a failure takes as long as finding it.
settings.register_profile(
    "quick",
    max_examples=30,
    derandomize=True,
    deadline=None,
    database=None,
    phases=(Phase.explicit, Phase.generate, Phase.shrink),
    suppress_health_check=(HealthCheck.too_slow,),
)
settings.register_profile("long", settings.get_profile("quick"), max_examples=1000, derandomize=False, print_blob=True)


def pytest_configure(config: pytest.Config) -> None:
    """Load the quick profile of hypothesis, if no other is asked for."""
    if not config.getoption("--hypothesis-profile"):
        settings.load_profile("quick")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--part", metavar="I/N", help="run one of N parts of the chosen tests: those of number I, from 0")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests of one part, whatever is added to others, and give slow tests more time."""
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_LIMIT_S))
    if (part := config.getoption("--part")) is None:
        return
    number, _, count = part.partition("/")
    if not (number.isdecimal() and count.isdecimal() and int(number) < int(count)):
        raise pytest.UsageError(f"--part {part}: two integers such as 0/8, the first below the second")
    kept = [item for item in items if zlib.crc32(item.nodeid.encode()) % int(count) == int(number)]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(kept)])
    items[:] = kept


def pytest_collection_finish() -> None:
    """Spare garbage collections what is there for good: half a million objects, a tenth of the time of all tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def plain_terminal() -> Iterator[None]:
    """What the terminal of whoever runs the tests is set to changes nothing that they read."""
    with pytest.MonkeyPatch.context() as patch:
        for variable in ("COLUMNS", "LINES", "FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
            patch.delenv(variable, raising=False)
        yield


@pytest.fixture(scope="session", autouse=True)
def loaded_once() -> Iterator[None]:
    """Parts of hands and objects that many tests load are computed once."""
    from remembered import remembered  # later than the hook that checks annotations

    with remembered():
        yield


@pytest.fixture(params=["native", "python"])
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Engine that "auto" stands for: one after the other; skips where the compiled one is not available."""
    if request.param == "native" and why_not_native():
        pytest.skip(f"no compiled engine: {why_not_native()}")
    monkeypatch.setenv(VARIABLE, request.param)
    return request.param


@pytest.fixture(scope="session")
def shared_assets() -> Path:
    """The folder of third-party hands, objects and grasps beside the repository; skips where it is absent."""
    folder = Path(__file__).resolve().parents[1] / "../shared/assets"
    if not folder.is_dir():
        pytest.skip(f"the shared assets are not here: {folder}")
    return folder.resolve()


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to run commands in, with a cache of its own."""
    folder = tmp_path / "workplace"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "80")
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(variable, "1")  # what main would set, undone after the test
    return folder


@pytest.fixture
def threads() -> Iterator[None]:
    """The number of threads of torch that a test sets is undone."""
    import torch

    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)
