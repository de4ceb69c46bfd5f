"""Tasks of a group stay together, and the first of a group goes ahead."""

from pathlib import Path

from grasp_refine_apps.processes.schedule import Schedule
from worker_tasks import some_tasks


def test_a_worker_gets_the_tasks_of_a_group_one_after_the_other():
    schedule = Schedule(some_tasks(Path(), "a:", "b:", "a:", "b:", "a:"))
    order, loaded = [], None
    while task := schedule.take(loaded):
        order.append(task.number)
        loaded = task.group
        schedule.finish(task)
    assert order == [0, 2, 4, 1, 3]
    assert len(schedule) == 0


def test_groups_are_opened_in_their_order_by_workers_that_have_none():
    schedule = Schedule(some_tasks(Path(), "a:", "a:", "b:", "b:", "c:"))
    assert [schedule.take(None).group for _ in range(3)] == ["a", "b", "c"]


def test_the_others_of_a_group_wait_for_its_first_while_there_is_other_work():
    schedule = Schedule(some_tasks(Path(), "a:", "a:", "a:", "b:", "b:"))
    first, second = schedule.take(None), schedule.take(None)
    assert (first.number, second.number) == (0, 3)
    schedule.finish(second)
    assert schedule.take(None).number == 4, "b has fewer tasks left, but its first is done"
    assert schedule.take(None).number == 1, "nothing else is left to do"


def test_they_wait_also_for_a_worker_that_has_loaded_the_group():
    schedule = Schedule(some_tasks(Path(), "a:", "a:", "b:"))
    assert [schedule.take(None).number, schedule.take("a").number, schedule.take("a").number] == [0, 2, 1]


def test_a_task_that_is_tried_again_comes_after_the_others_of_its_group():
    schedule = Schedule(some_tasks(Path(), "a:", "a:"))
    first = schedule.take(None)
    schedule.requeue(first)
    assert len(schedule) == 2
    assert [schedule.take("a").number, schedule.take("a").number] == [1, 0]
    assert schedule.take("a") is None


def test_a_group_whose_first_task_was_lost_has_a_first_again():
    schedule = Schedule(some_tasks(Path(), "a:", "a:", "a:", "b:", "b:"))
    schedule.requeue(schedule.take(None))
    one, other = schedule.take(None), schedule.take(None)
    assert (one.group, other.group) == ("b", "a")
    schedule.finish(one)
    assert schedule.take(None).group == "b", "a waits for its new first task"


def test_when_all_groups_are_open_the_one_with_most_tasks_left_is_shared():
    schedule = Schedule(some_tasks(Path(), "a:", "a:", "b:", "b:", "b:"))
    for _ in range(2):
        schedule.finish(schedule.take(None))
    assert schedule.take(None).group == "b"


def test_a_group_that_waits_to_be_opened_again_is_not_opened_twice():
    """Two of its tasks were lost, and a worker that had it loaded took all that was left: the next `take` failed."""
    schedule = Schedule(some_tasks(Path(), "a:", "a:", "a:", "b:", "b:"))
    first = schedule.take(None)
    second = schedule.take(None)
    schedule.finish(second)
    assert second.group == "b"
    others = [schedule.take("b"), schedule.take(None)]
    assert [task.number for task in others] == [4, 1]
    schedule.requeue(first)
    schedule.requeue(others[1])
    done = []
    while task := schedule.take("a"):
        done.append(task.number)
        schedule.finish(task)
    assert sorted(done) == [0, 1, 2] and len(schedule) == 0
