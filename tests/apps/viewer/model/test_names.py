"""Names for people and of files."""

from grasp_refine_apps.viewer.model.names import file_stem, shortened


def test_hashes_are_cut_and_other_names_are_not():
    assert shortened("core/bottle-1a7ba1f4c892e2da30711cdbdfc73924") == "core/bottle-1a7ba1…"
    for name in ("mug", "sem-Bottle-1234", "abcdefabcdefg", "box:0.04,0.05,0.06", "deadbeef"):
        assert shortened(name) == name


def test_letters_of_any_script_stay_in_names_of_files():
    assert file_stem("allegro_Kännchen 3") == "allegro_Kännchen_3" and file_stem("../a/b") == "_a_b"
    assert len((file_stem("茶" * 200) + ".npz").encode()) <= 255
