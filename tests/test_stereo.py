"""Depth from two pictures: against shifted textures, published disparity and sized objects."""

import math
import os
import pickle
import sys
from importlib.util import find_spec
from pathlib import Path

import attrs
import numpy as np
import pytest

import imgscale as ims
from imgscale.datasets import motorcycle
from imgscale.depth_sources.files import read_values
from imgscale.depth_sources.stereo import StereoDepth, stereo_disparity
from imgscale.errors import MissingDependencyError

DATA = Path(
    os.environ.get("IMGSCALE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data"
)
MIDDLEBURY = DATA / "middlebury2014" / "Motorcycle"
KITTI = DATA / "kitti" / "scene_flow_2015" / "training"

needs_cv2 = pytest.mark.skipif(find_spec("cv2") is None, reason="OpenCV is not installed")
needs_middlebury = pytest.mark.skipif(
    not (MIDDLEBURY / "im1.png").is_file(), reason=f"no pair in {MIDDLEBURY}"
)
needs_kitti = pytest.mark.skipif(
    not (KITTI / "image_3" / "000046_10.png").is_file(), reason=f"no pair in {KITTI}"
)


def texture(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def shifted_pair(shift, *, height=60, width=240):
    """Cut both pictures from one texture, so that `left[y, x]` is `right[y, x - shift]`."""
    wall = texture(height, width + 200)
    return wall[:, 100 : 100 + width], wall[:, 100 + shift : 100 + shift + width]


def picture(path):
    from PIL import Image  # noqa: PLC0415 - only where the data are

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


# --- known disparity ---


@needs_cv2
@pytest.mark.parametrize("shift", [1, 17, 28])
def test_a_wall_that_faces_the_camera_has_one_disparity(shift):
    disparity = stereo_disparity(*shifted_pair(shift))
    seen = np.isfinite(disparity)
    assert disparity.dtype == np.float64
    assert not seen[:, :shift].any()  # the right camera does not see these
    assert seen[:, shift:].mean() > 0.98  # nor are columns lost to the search range of 32
    assert np.median(disparity[seen]) == pytest.approx(shift, abs=1 / 16)
    np.testing.assert_allclose(disparity[seen], shift, atol=0.25)  # interpolated between pixels


@needs_cv2
def test_disparity_may_be_negative_where_the_range_says_so():
    disparity = stereo_disparity(*shifted_pair(-9), min_disparity_px=-20, max_disparity_px=5)
    assert not np.isfinite(disparity[:, -9:]).any()
    assert np.isfinite(disparity[:, :-9]).mean() > 0.98
    assert np.nanmedian(disparity) == pytest.approx(-9, abs=1 / 16)


@needs_cv2
def test_what_a_near_box_hides_from_the_right_camera_has_no_disparity():
    left, right = (image.copy() for image in shifted_pair(8))
    box = texture(30, 60, seed=1)
    left[15:45, 120:180] = box
    right[15:45, 90:150] = box  # disparity 30
    disparity = stereo_disparity(left, right, max_disparity_px=40)
    np.testing.assert_allclose(np.nanmedian(disparity[20:40, 125:175]), 30, atol=1 / 16)
    np.testing.assert_allclose(np.nanmedian(disparity[20:40, 60:90]), 8, atol=1 / 16)
    # columns 98 to 119 of the wall stand behind the box in the right picture
    assert np.isfinite(disparity[20:40, 101:117]).mean() < 0.05


@needs_cv2
def test_objects_beyond_the_range_on_either_side_have_no_disparity():
    for least, most in ((0, 20), (40, 60)):
        with pytest.raises(ValueError, match="must be a rectified pair"):
            stereo_disparity(*shifted_pair(32), min_disparity_px=least, max_disparity_px=most)
    disparity = stereo_disparity(*shifted_pair(32), min_disparity_px=25, max_disparity_px=35)
    assert np.nanmedian(disparity) == pytest.approx(32, abs=1 / 16)


@needs_cv2
def test_grey_pictures_and_colour_ones_of_the_same_greys_agree():
    left, right = (image[:, :, 0] for image in shifted_pair(17))
    grey = stereo_disparity(left, right)
    colour = stereo_disparity(np.dstack([left] * 3), np.dstack([right] * 3))
    np.testing.assert_allclose(np.nanmedian(grey), 17, atol=1 / 16)
    both = np.isfinite(grey) & np.isfinite(colour)
    assert both.mean() > 0.9
    np.testing.assert_allclose(grey[both], colour[both], atol=1 / 16)


@needs_cv2
def test_pictures_are_not_written_to_and_need_not_be_contiguous():
    left, right = shifted_pair(17)
    left, right = left[:, :, ::-1], right[:, :, ::-1]
    left.flags.writeable = right.flags.writeable = False
    assert np.nanmedian(stereo_disparity(left, right)) == pytest.approx(17, abs=1 / 16)


# --- depth ---


@needs_cv2
def test_depth_is_focal_length_times_baseline_over_disparity_and_doffs():
    pair = shifted_pair(17)
    depth = StereoDepth(700.0, 0.5, doffs_px=3.0, scale_rel_std=0.01)(*pair)
    assert (depth.kind, depth.image_size, depth.scale_rel_std) == ("metric", (240, 60), 0.01)
    assert np.nanmedian(depth.values) == pytest.approx(700 * 0.5 / 20, rel=1e-9)
    np.testing.assert_array_equal(np.isnan(depth.values), np.isnan(stereo_disparity(*pair)))


@needs_cv2
def test_doffs_make_depth_of_negative_disparity():
    stereo = StereoDepth(700.0, 0.5, doffs_px=29.0, min_disparity_px=-20, max_disparity_px=5)
    depth = stereo(*shifted_pair(-9))
    assert np.nanmedian(depth.values) == pytest.approx(700 * 0.5 / 20, rel=1e-9)


@needs_cv2
def test_beside_its_right_picture_it_is_a_depth_source_for_measure():
    left, right = (image.copy() for image in shifted_pair(17))
    stereo = StereoDepth(200.0, 0.5)
    source = stereo.beside(right)
    expected = stereo(left, right)
    right[:] = 0  # a camera's buffer is used again
    assert isinstance(source, ims.DepthSource)
    result = ims.measure(
        left,
        detector=lambda _: [ims.Detection("door", (100, 5, 120, 55))],
        depth_source=source,
        priors=ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.1)]),
    )
    np.testing.assert_array_equal(result.depth.values, expected.values)
    again = pickle.loads(pickle.dumps(source))  # noqa: S301 - our own bytes
    np.testing.assert_array_equal(again(left).values, expected.values)


# --- real pairs ---


@pytest.fixture(scope="module")
def scene():
    return motorcycle.load()


@pytest.fixture(scope="module")
def motorcycle_disparity(scene):
    ski = pytest.importorskip("skimage")
    left, right, _ = ski.data.stereo_motorcycle()
    np.testing.assert_array_equal(left, scene.image)
    return stereo_disparity(left, right)


def sizes_of(scene, depth):
    model = ims.fit(scene.detections, depth, scene.priors, noise=scene.noise)
    return {e.label: e.size_m for e in ims.predict(model, scene.detections, depth)}


@needs_cv2
def test_the_motorcycle_is_sized_from_its_two_pictures_as_from_the_published_disparity(
    scene, motorcycle_disparity
):
    # anchored on the rear tyre. Measured: 0 to 0.6 %, with OpenCV 4.10 and 5.0
    depth = ims.DepthMap(motorcycle_disparity + 31.086, kind="inverse")
    ours, published = sizes_of(scene, depth), sizes_of(scene, scene.depth)
    assert len(ours) == 6
    for label, size in published.items():
        assert ours[label] == pytest.approx(size, rel=0.02)


@needs_cv2
def test_metric_depth_of_the_pair_gives_the_same_sizes_as_its_disparity(
    scene, motorcycle_disparity
):
    ski = pytest.importorskip("skimage")
    stereo = StereoDepth(994.978, motorcycle.PUBLISHED_BASELINE_M, doffs_px=31.086)
    left, right, _ = ski.data.stereo_motorcycle()
    metric = sizes_of(scene, stereo(left, right))
    inverse = sizes_of(scene, ims.DepthMap(motorcycle_disparity + 31.086, kind="inverse"))
    assert metric == pytest.approx(inverse, rel=1e-9)


def relative_depth_errors(disparity, published, doffs=0.0):
    both = np.isfinite(disparity) & np.isfinite(published)
    coverage = both.sum() / np.isfinite(published).sum()
    return coverage, np.abs((published + doffs)[both] / (disparity + doffs)[both] - 1)


@needs_cv2
def test_the_motorcycles_depth_errs_by_a_quarter_of_a_percent(scene, motorcycle_disparity):
    # Measured: 88.9 % of the pixels, median 0.25 %, nine tenths within 0.98 %
    published = scene.shifted_disparity - 31.086
    coverage, errors = relative_depth_errors(motorcycle_disparity, published, 31.086)
    assert coverage >= 0.85
    assert np.median(errors) <= 0.003
    assert np.quantile(errors, 0.9) <= 0.012


@needs_cv2
@needs_middlebury
def test_middleburys_own_rectification_errs_as_little_and_loses_what_is_hidden():
    # Measured: 87.8 %, median 0.26 %, nine tenths within 1.1 %; 95 % of what both cameras see
    # has a disparity, 31 % of what the right one does not
    disparity = stereo_disparity(picture(MIDDLEBURY / "im0.png"), picture(MIDDLEBURY / "im1.png"))
    published = read_values(MIDDLEBURY / "disp0GT.pfm")
    coverage, errors = relative_depth_errors(disparity, published, 32.778)
    assert coverage >= 0.85
    assert np.median(errors) <= 0.003
    assert np.quantile(errors, 0.9) <= 0.012
    mask = picture(MIDDLEBURY / "mask0nocc.png")[:, :, 0]
    assert np.isfinite(disparity)[mask == 255].mean() > 0.93
    assert np.isfinite(disparity)[mask == 128].mean() < 0.35


@needs_cv2
@needs_kitti
def test_a_street_of_kitti_errs_by_less_than_two_percent():
    # Measured: 90.9 % of the pixels with LiDAR, median 1.6 %, 1.2 % off by more than 3 px. The
    # frame is rectified to about 0.4 px: windows matched by correlation are off by as much.
    pair = [picture(KITTI / f"image_{i}" / "000046_10.png") for i in (2, 3)]
    published = read_values(KITTI / "disp_occ_0" / "000046_10.png", scale=256)
    disparity = stereo_disparity(*pair)
    coverage, _ = relative_depth_errors(disparity, published)
    depth = StereoDepth(721.5377, 0.53273)(*pair).values
    true_depth = ims.DepthMap.from_disparity(published, focal_px=721.5377, baseline_m=0.53273)
    errors = np.abs(depth / true_depth.values - 1)
    assert coverage >= 0.88
    assert np.nanmedian(errors) <= 0.02
    wrong = np.abs(disparity - published) > 3
    assert wrong.sum() / (np.isfinite(disparity) & np.isfinite(published)).sum() <= 0.02


# --- what is refused ---


@needs_cv2
def test_a_swapped_unrelated_or_blank_pair_is_refused():
    ski = pytest.importorskip("skimage")
    left, right, _ = ski.data.stereo_motorcycle()
    blank = np.zeros_like(left)
    # with doffs, a disparity of 0 everywhere would look like a wall 6 m away
    for pair in ((right, left), (left, left[::-1]), (left, left), (blank, blank)):
        with pytest.raises(ValueError, match=r"the left camera's picture first; got [0-7]% of"):
            stereo_disparity(*pair)


@needs_cv2
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (3, 2), (5, 5)], ids=str)
def test_pictures_too_small_to_match_are_refused(shape):
    image = texture(*shape)
    with pytest.raises(ValueError, match="must be a rectified pair"):
        stereo_disparity(image, image)


IMAGE = np.zeros((4, 6, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        (IMAGE, IMAGE[:, 1:], r"`right` must have the shape of `left`, \(4, 6, 3\); got \(4, 5, 3"),
        (
            IMAGE,
            IMAGE[:, :, 0],
            r"`right` must have the shape of `left`, \(4, 6, 3\); got \(4, 6\)",
        ),
        (IMAGE.astype(np.uint16), IMAGE, r"`left` must be .* uint8; got \(4, 6, 3\) uint16"),
        (IMAGE, IMAGE / 255, r"`right` must be .* uint8; got \(4, 6, 3\) float64"),
        (np.zeros((4, 6, 4), dtype=np.uint8), IMAGE, r"`left` must be .* got \(4, 6, 4\) uint8"),
        (IMAGE[:0], IMAGE[:0], r"`left` must be .* got \(0, 6, 3\) uint8"),
    ],
    ids=["size", "grey", "16 bits", "floats", "alpha", "empty"],
)
def test_what_is_no_pair_of_pictures_is_refused_before_opencv_is_needed(left, right, message):
    with pytest.raises(ValueError, match=message):
        stereo_disparity(left, right)


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        ("left.png", "right.png", "`left` must be .* got str"),
        (IMAGE, None, "`right` must be .* got NoneType"),
        (IMAGE.tolist(), IMAGE, "`left` must be .* got list"),
    ],
    ids=["path", "none", "list"],
)
def test_what_is_no_array_is_of_another_type(left, right, message):
    with pytest.raises(TypeError, match=message):
        stereo_disparity(left, right)


def test_a_right_picture_is_looked_at_when_it_is_given():
    with pytest.raises(TypeError, match="`right` must be"):
        StereoDepth(700.0, 0.5).beside("right.png")
    with pytest.raises(ValueError, match="`right` must be"):
        StereoDepth(700.0, 0.5).beside(IMAGE / 255)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"max_disparity_px": 0}, ValueError, "must be above `min_disparity_px`, 0; got 0"),
        ({"min_disparity_px": 70, "max_disparity_px": 64}, ValueError, "above .* 70; got 64"),
        ({"max_disparity_px": 64.0}, TypeError, "`max_disparity_px` must be a whole number"),
        ({"min_disparity_px": True}, TypeError, "`min_disparity_px` must be a whole number"),
        ({"min_disparity_px": None}, TypeError, "`min_disparity_px` must be a whole number"),
        ({"max_disparity_px": 2001}, ValueError, "must be between -2000 and 2000; got 2001"),
    ],
    ids=["empty", "reversed", "float", "bool", "none", "huge"],
)
def test_a_search_that_finds_nothing_is_refused(options, error, message):
    with pytest.raises(error, match=message):
        stereo_disparity(IMAGE, IMAGE, **options)
    with pytest.raises(error, match=message):
        StereoDepth(700.0, 0.5, **options)


@pytest.mark.parametrize(
    "change",
    [
        {"focal_px": 0.0},
        {"focal_px": -721.5},
        {"baseline_m": math.inf},
        {"baseline_m": "54 cm"},
        {"doffs_px": math.nan},
        {"scale_rel_std": -0.1},
    ],
    ids=str,
)
def test_a_calibration_that_breaks_its_law_is_refused_by_name(change):
    (name,) = change
    with pytest.raises((ValueError, TypeError), match=f"`{name}` must be finite"):
        attrs.evolve(StereoDepth(721.5, 0.54), **change)


def test_a_stereo_camera_is_a_frozen_value():
    stereo = StereoDepth(700, 0.5)
    assert stereo == StereoDepth(700.0, 0.5, doffs_px=0)
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        stereo.focal_px = 800.0


def test_without_opencv_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'imgscale\[stereo\]'"):
        stereo_disparity(*shifted_pair(17))
