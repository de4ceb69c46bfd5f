"""The table of grasps and the lines about one of them: what they say, and that names in files do nothing."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from grasp_refine.measures.measures import COMPARED
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.results.verdict import HOLDS
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import FAILED_TEXT, HELD, REASON, Column
from grasp_refine_apps.viewer.model.listing import Listing
from grasp_refine_apps.viewer.panels.browse_panel import metrics_html  # noqa: E402
from grasp_refine_apps.viewer.panels.table import ROWS_PER_PAGE, page_of, pages, shown_columns, table_html
from made_results import save_example_results
from open_viewer import made_trial

EVIL = "</td><script>alert(1)</script><img src=x onerror=alert(2)>\"' onclick=alert(3) x='"


class Parsed(HTMLParser):
    """Tags with their attributes, and the texts of cells."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.cells: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "td":
            self.cells.append("")

    def handle_data(self, data: str) -> None:
        if self.cells:
            self.cells[-1] += data

    def doing(self, what: str) -> list[str]:
        """What the clicks say that begin with a word."""
        return [said for _, attributes in self.tags if (said := attributes.get("data-do") or "").startswith(what)]


@pytest.fixture(scope="module")
def collection(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    path = save_example_results(tmp_path_factory.mktemp("table") / "results.npz", 100)
    return Collection.of(load_problem(ProblemSpec(grasps=path)))


def table(collection: Collection, listing: Listing, page: int = 0, number: int = 0) -> Parsed:
    return Parsed(table_html(collection, listing, listing.numbers(collection), page, number, 'an "identifier"'))


def renamed(collection: Collection, name: str) -> Collection:
    """The same grasps, half of them on an object of another name."""
    (group,) = collection.problem.groups
    number = np.arange(len(group.rows))
    even, odd = number[::2], number[1::2]
    parts = [replace(group, object=text, index=group.index[rows]) for text, rows in ((name, even), ("mug", odd))]
    problem = replace(collection.problem, groups=tuple(parts))
    return replace(collection, problem=problem, group_of=number % 2, member=number // 2)


def test_a_page_lists_its_grasps_in_order(collection: Collection) -> None:
    listing = Listing("quality_after", descending=True)
    page = table(collection, listing, page=1)
    # The quality of grasp i is 7 i mod 100 hundredths.
    expected = sorted(range(100), key=lambda i: -(7 * i % 100))[ROWS_PER_PAGE : 2 * ROWS_PER_PAGE]
    assert page.doing("open ") == [f"open {i}" for i in expected]
    assert page.cells[:5] == [str(expected[0]), "0.840", "0.01", "0.12", "converged"]
    assert page.doing("sort ") == [
        f"sort {key}"
        for key in ("number", "quality_after", "contact_error_m_after", "penetration_m_after", "status", "mark")
    ]
    assert page.doing("page ") == ["page 0", "page 0", "page 2", "page 6"]
    assert "16 to 30 of 100" in "".join(page.cells)


def test_the_shown_grasp_is_marked_on_its_page(collection: Collection) -> None:
    numbers = Listing().numbers(collection)
    assert [page_of(numbers, number) for number in (0, 14, 15, 99, 1000)] == [0, 0, 1, 6, 0]
    assert (pages(numbers), pages(numbers[:ROWS_PER_PAGE]), pages(numbers[:0])) == (7, 1, 1)
    (opened,) = [at for tag, at in table(collection, Listing(), number=3).tags if at.get("class") == "gr-open"]
    assert (opened["data-do"], opened["title"]) == ("open 3", "mug 3")


def test_colours_say_what_holds(collection: Collection) -> None:
    listing = Listing("quality_after", descending=True)
    rows = table_html(collection, listing, listing.numbers(collection), 0, 0, "w").split("<tr data-do=")[1:]
    good = ["gr-good" in row for row in rows]
    assert good == [value / 100 >= HOLDS for value in range(99, 99 - ROWS_PER_PAGE, -1)]
    assert 0 < sum(good) < ROWS_PER_PAGE
    simulated = collection.with_trials({0: made_trial(Reason.HELD), 1: made_trial(Reason.MOVED)})
    page = table(simulated, Listing())
    assert page.cells[4:6] == ["held", ""]
    classes = [attributes.get("class") for tag, attributes in page.tags if tag == "td"]
    assert (classes[4], classes[10], classes[16]) == ("gr-good", "gr-bad", None)


def test_columns_without_any_value_are_left_out_and_an_empty_list_has_no_rows(collection: Collection) -> None:
    page = table(collection, Listing(object="cup"))
    assert len(page.cells) == 1 and "100" in page.cells[0] and not page.doing("open ")
    assert [column.key for column in shown_columns(replace(collection, columns={}))] == ["mark"]
    gap = Column("contact_distance_m_after", "Contact distance", "", np.full(100, 1e-3), "mm", 1e3)
    keys = [column.key for column in shown_columns(replace(collection, columns={"contact_distance_m_after": gap}))]
    assert keys == ["contact_distance_m_after", "mark"]


@pytest.mark.parametrize("key", ["status", "reason"])
def test_names_in_files_are_texts_and_nothing_else(collection: Collection, key: str) -> None:
    evil = renamed(collection, EVIL)
    evil = evil.with_columns(Column(key, "Status", "", np.full(100, EVIL)))
    evil = evil.with_columns(HELD.with_values(np.full(100, FAILED_TEXT)), REASON.with_values(np.full(100, EVIL)))
    for html in (table_html(evil, Listing(), np.arange(100), 0, 0, "w"), metrics_html(evil, 0)):
        page = Parsed(html)
        assert {tag for tag, _ in page.tags} <= {*"style div table thead tbody tr th td small span a b br".split()}
        handlers = [name for _, attributes in page.tags for name in attributes if name.startswith("on")]
        assert handlers == (["onclick"] if "gr-table" in html else [])
        known = {"class", "data-do", "title", "onclick", "aria-disabled"}
        assert {name for _, attributes in page.tags for name in attributes} <= known
    rows = Parsed(table_html(evil, Listing(), np.arange(2), 0, 0, "w")).tags
    titles = [attributes["title"] for tag, attributes in rows if tag == "tr" and "title" in attributes]
    assert titles == [f"{EVIL} 0", "mug 1"]


def test_a_refined_grasp_is_reported_before_and_after(collection: Collection) -> None:
    marked = collection.with_mark(13, "bad").with_trials({13: made_trial(Reason.ROTATED)})
    html = metrics_html(marked, 13)
    heading = html.partition("<table>")[0]
    for told in ("<b>mug 13</b>", "converged", "rotated", "bad"):
        assert told in heading
    # Quality 7 * 13 = 91 hundredths, and half of it before.
    cells = Parsed(html).cells
    rows = [tuple(cells[i : i + 3]) for i in range(0, len(cells), 3)]
    assert rows[:2] == [("", "before", "after"), ("Quality", "0.455", "0.910")]
    assert ("Contact error, mm", "1.01", "0.01") in rows
    known = [measure for measure in COMPARED if set(measure.entries.values()) <= collection.columns.keys()]
    assert len(rows) == 1 + len(known) >= 6
    assert not Parsed(metrics_html(replace(collection, columns={}), 13)).cells
    plain = {key: column for key, column in collection.columns.items() if key.endswith("_after")}
    assert Parsed(metrics_html(replace(collection, columns=plain), 13)).cells[:2] == ["Quality", "0.910"]


def test_a_grasp_that_cannot_be_drawn_says_why_in_place_of_measures(collection: Collection) -> None:
    (group,) = collection.problem.groups
    q = group.scene.q.copy()
    q[1] = np.nan
    group = replace(group, scene=replace(group.scene, q=q))
    broken = replace(collection, problem=replace(collection.problem, groups=(group,)))
    cells = table(broken, Listing()).cells
    width = len(shown_columns(broken)) + 1
    assert cells[width] == "1" and "not finite" in cells[width + 1] and cells[width + 2] == "2"
