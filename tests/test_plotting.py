"""Pictures of results: what is drawn where."""

import re

import numpy as np
import pytest

import imgscale as ims
from imgscale.plotting import draw_sizes

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

from matplotlib.figure import Figure
from PIL import Image


def results(width, height, label="thing"):
    detections = [
        ims.Detection("pole", (0.1 * width, 0.1 * height, 0.2 * width, 0.8 * height)),
        ims.Detection(label, (0.5 * width, 0.4 * height, 0.7 * width, 0.6 * height)),
        ims.Detection("far", (0.8 * width, 0.4 * height, 0.9 * width, 0.6 * height)),
    ]
    depth = ims.ObjectDepths([4.0, 4.0, np.nan], kind="relative", rel_std=0.0)
    table = ims.PriorTable([ims.ObjectPrior("pole", 0.7, 0.01)])
    model = ims.fit(detections, depth, table, method="robust", noise=ims.Noise(box_px=0.0))
    image = np.zeros((height, width, 3), dtype=np.uint8)
    return image, detections, ims.predict(model, detections, depth)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(300, 200), (4000, 3000), (300, 1200)], ids=str)
def test_the_picture_is_at_least_as_large_as_the_photo_and_of_its_shape(tmp_path, size):
    draw_sizes(*results(*size)).figure.savefig(tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert max(picture.size) >= max(size)
        assert picture.size[0] / picture.size[1] == pytest.approx(size[0] / size[1], rel=0.01)


def test_each_box_is_labelled_with_its_size_and_interval():
    ax = draw_sizes(*results(640, 480))
    texts = [text.get_text() for text in ax.texts]
    # the thing is 0.2 of the height, the pole of 0.7 m is 0.7 of it; 1.4 % is 90 % of 1 / 70
    assert texts[1].startswith("thing\n0.2000 m (0.19")
    assert texts[2] == "far\nno depth"
    low, high = map(float, re.findall(r"\((.*) to (.*)\)", texts[1])[0])
    assert (low, high) == (pytest.approx(0.1953, abs=2e-4), pytest.approx(0.2048, abs=2e-4))


def test_references_and_other_objects_differ_in_colour_and_line():
    ax = draw_sizes(*results(640, 480))
    pole, thing, far = ax.patches
    assert pole.get_linestyle() != thing.get_linestyle() == far.get_linestyle()
    assert pole.get_edgecolor() != thing.get_edgecolor()
    assert [line.get_text() for line in ax.get_legend().get_texts()] == [
        "known size (reference)", "measured",
    ]  # fmt: skip


def test_labels_of_neighbours_do_not_cover_each_other():
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    detections = [
        ims.Detection("pole", (300 + 12 * i, 200 + 5 * i, 340 + 12 * i, 300 + 5 * i))
        for i in range(3)
    ]
    depth = ims.ObjectDepths([4.0] * 3, kind="relative")
    table = ims.PriorTable([ims.ObjectPrior("pole", 1.0, 0.1)])
    model = ims.fit(detections, depth, table)
    ax = draw_sizes(image, detections, ims.predict(model, detections, depth))
    extents = [text.get_window_extent() for text in ax.texts]
    for i, one in enumerate(extents):
        assert not any(one.overlaps(other) for other in extents[i + 1 :])


@pytest.mark.parametrize("ending", ["svg", "pdf"])
def test_vector_pictures_and_dollar_signs_in_labels_work(tmp_path, ending):
    draw_sizes(*results(640, 480, label="5 $ or 6 $")).figure.savefig(tmp_path / f"a.{ending}")
    assert (tmp_path / f"a.{ending}").stat().st_size > 1000


def test_axes_given_are_drawn_on_and_returned():
    ax = Figure().add_subplot()
    assert draw_sizes(*results(640, 480), ax=ax) is ax
    assert len(ax.patches) == 3


def test_estimates_of_other_detections_are_refused():
    image, detections, estimates = results(640, 480)
    with pytest.raises(ValueError, match="one per detection, 3; got 2"):
        draw_sizes(image, detections, estimates[:2])
