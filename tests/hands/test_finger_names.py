"""What fingers are called."""

import pytest

from grasp_refine.hands.files.finger_names import finger_names


@pytest.mark.parametrize(
    ("tips", "fingers"),
    [
        (["ffdistal", "mfdistal", "rfdistal", "lfdistal", "thdistal"], ["index", "middle", "ring", "little", "thumb"]),
        (["finger_1_link_3", "finger_middle_link_3"], [None, "middle"]),
        (["index_middle_bone", "middle_middle_bone", "Pinky_L2"], ["index", "middle", "little"]),
        (["finger1_middle", "finger2_middle"], [None, None]),
        (["left_thumb_tip", "right_thumb_tip", "ring_tip"], [None, None, "ring"]),
        (["spring_tip", "throttle", "offset"], [None, None, None]),
    ],
)
def test_names_identify_fingers_or_nothing(tips: list[str], fingers: list[str | None]) -> None:
    assert finger_names([[tip] for tip in tips]) == fingers


def test_the_name_nearest_to_the_tip_counts() -> None:
    assert finger_names([["pad_7", "THJ1", "index_mount"], ["pad_8", "if_mcp"]]) == ["thumb", "index"]
