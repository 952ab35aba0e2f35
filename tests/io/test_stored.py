import numpy as np

from simgap.io.arrays_on_disk import room_in


def test_numbers_come_back_from_a_file_without_a_name(tmp_path):
    rng = np.random.default_rng(0)
    d = rng.normal(size=(50, 3))
    kept = room_in(tmp_path / "new", held=149)(d.shape)
    for first, last in ((20, 50), (0, 7), (7, 20)):
        kept.put(first, d[first:last])
    assert np.array_equal(kept.whole(), d)
    assert np.array_equal(kept[5:9], d[5:9])
    assert np.array_equal(kept[np.array([49, 0, 3, 3])], d[[49, 0, 3, 3]])
    assert kept[np.array([], dtype=np.int64)].shape == (0, 3)
    assert kept.ends() == (d.min(), d.max())
    assert (tmp_path / "new").is_dir()
    assert not list((tmp_path / "new").iterdir())  # the file has no name


def test_few_numbers_are_in_memory(tmp_path):
    room_in(tmp_path / "new", held=150)((50, 3))
    assert not (tmp_path / "new").exists()
