"""The whole chain on one picture: what detectors see, what comes back, and what is refused."""

import json
import typing

import attrs
import numpy as np
import pytest
from PIL import ExifTags, Image, ImageOps

import imgscale as ims

SIZE = (120, 80)  # of the pictures here, width and height
DOOR = ims.Detection("door", (20, 10, 40, 60))  # 50 px high
STATUE = ims.Detection("statue", (60, 20, 90, 70))  # 50 px high, 30 px wide
DOORS_ONLY = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
# where the file's first pixel belongs in the scene: EXIF 2.3, tag 274, "row 0 / column 0"
FIRST_PIXEL = {
    1: ("top", "left"),
    2: ("top", "right"),
    3: ("bottom", "right"),
    4: ("bottom", "left"),
    5: ("top", "left"),
    6: ("top", "right"),
    7: ("bottom", "right"),
    8: ("bottom", "left"),
}


class Recorder:
    """A detector that keeps the picture it was shown."""

    def __init__(self, *detections):
        self.detections = detections or (DOOR, STATUE)
        self.images = []

    def __call__(self, image):
        self.images.append(image)
        return list(self.detections)


def two_distances(image):
    """Depth 4 in the left half of the picture, 8 in the right half, up to a factor."""
    values = np.full(image.shape[:2], 8.0)
    values[:, : image.shape[1] // 2] = 4.0
    return ims.DepthMap(values, kind="relative")


def flat(image):
    return ims.DepthMap(np.full(image.shape[:2], 4.0), kind="relative")


def picture(size=SIZE):
    """Make a grey picture whose first corner, as stored, is red."""
    width, height = size
    pixels = np.full((height, width, 3), 128, np.uint8)
    pixels[: height // 2, : width // 2] = (255, 0, 0)
    return pixels


def red_corner(image):
    """Name the corner of the picture that is red."""
    height, width, _ = image.shape
    rows = {"top": height // 4, "bottom": height - 1 - height // 4}
    columns = {"left": width // 4, "right": width - 1 - width // 4}
    found = [
        (row, column)
        for row, y in rows.items()
        for column, x in columns.items()
        if image[y, x, 0] > 200 and image[y, x, 1] < 100
    ]
    (corner,) = found
    return corner


def with_orientation(path, orientation):
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(picture()).save(path, exif=exif, quality=95)
    return path


def measure(image, **options):
    options = {
        "detector": Recorder(),
        "depth_source": two_distances,
        "priors": DOORS_ONLY,
    } | options
    return ims.measure(image, **options)


# --- the picture ---


def test_an_array_reaches_detector_and_depth_source_as_it_is():
    detector, depth_source = Recorder(), Recorder()
    image = picture()

    def source(pixels):
        depth_source(pixels)
        return two_distances(pixels)

    result = measure(image, detector=detector, depth_source=source)
    for seen in (detector.images, depth_source.images):
        assert len(seen) == 1
        assert np.array_equal(seen[0], image)
        assert seen[0].dtype == np.uint8
    assert result.image_size == SIZE


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("opened", [False, True], ids=["path", "PIL image"])
def test_exif_orientation_is_applied_exactly_once(tmp_path, orientation, opened):
    path = with_orientation(tmp_path / "photo.jpg", orientation)
    detector = Recorder(ims.Detection("door", (20, 10, 40, 60)))
    if opened:
        with Image.open(path) as image:
            result = measure(image, detector=detector, depth_source=flat)
    else:
        result = measure(path, detector=detector, depth_source=flat)
    (seen,) = detector.images
    turned = orientation >= 5
    assert seen.shape == ((120, 80, 3) if turned else (80, 120, 3))
    assert result.image_size == ((80, 120) if turned else (120, 80))
    assert red_corner(seen) == FIRST_PIXEL[orientation]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_detector_that_applies_the_orientation_itself_finds_nothing_left_to_turn(
    tmp_path, orientation
):
    path = with_orientation(tmp_path / "photo.jpg", orientation)
    shown = []

    def careful(image):
        opened = ImageOps.exif_transpose(Image.fromarray(image))
        shown.append(np.asarray(opened))
        return [DOOR]

    result = measure(path, detector=careful, depth_source=flat)
    assert red_corner(shown[0]) == FIRST_PIXEL[orientation]
    assert result.image_size == shown[0].shape[1::-1]


@pytest.mark.parametrize("told", [False, True])
def test_a_depth_source_may_bring_the_camera_it_found_out(told):
    own = ims.Camera(300.0, focal_rel_std=0.1)
    given = ims.Camera(500.0, focal_rel_std=0.0)
    depth = ims.ObjectDepths([4.0, 5.0], kind="metric")
    result = measure(picture(), depth_source=lambda _: (depth, own), camera=given if told else None)
    assert result.model.camera.focal_px == (500.0 if told else 300.0)
    assert result.depth is depth


def test_a_source_may_say_that_it_found_no_camera():
    depth = ims.ObjectDepths([4.0, 5.0], kind="metric")
    assert measure(picture(), depth_source=lambda _: (depth, None)).model.camera is None


def test_what_is_there_already_serves_as_what_a_function_would_return():
    depth = flat(picture())
    ready = measure(picture(), detector=[DOOR], depth_source=depth)
    assert ready == measure(picture(), detector=lambda _: [DOOR], depth_source=lambda _: depth)
    assert ready.depth is depth


def test_what_is_neither_function_nor_result_is_named():
    with pytest.raises(TypeError, match=r"`detector` must be or return a sequence .*got NoneType"):
        measure(picture(), detector=None)
    with pytest.raises(TypeError, match=r"`depth` must be a DepthMap.*got ndarray"):
        measure(picture(), depth_source=np.ones((4, 4)))


def test_a_pil_image_already_turned_is_not_turned_again(tmp_path):
    detector = Recorder(DOOR)
    with Image.open(with_orientation(tmp_path / "photo.jpg", 6)) as image:
        upright = ImageOps.exif_transpose(image)
    measure(upright, detector=detector, depth_source=flat)
    assert detector.images[0].shape == (120, 80, 3)
    assert red_corner(detector.images[0]) == ("top", "right")


@pytest.mark.parametrize("convert", [str, lambda path: path], ids=["text", "Path"])
def test_a_file_is_read_as_rgb_bytes(tmp_path, convert):
    path = tmp_path / "photo.png"
    Image.fromarray(picture()).save(path)
    detector = Recorder()
    measure(convert(path), detector=detector)
    assert np.array_equal(detector.images[0], picture())


@pytest.mark.parametrize("mode", ["L", "RGBA", "P", "CMYK", "1", "LA"])
def test_pictures_of_other_modes_become_rgb(mode):
    detector = Recorder()
    measure(Image.fromarray(picture()).convert(mode), detector=detector)
    assert detector.images[0].shape == (80, 120, 3)
    assert detector.images[0].dtype == np.uint8


def test_the_callers_pil_image_is_left_open_and_unchanged(tmp_path):
    path = with_orientation(tmp_path / "photo.jpg", 6)
    with Image.open(path) as image:
        measure(image, detector=Recorder(DOOR), depth_source=flat)
        assert image.size == SIZE
        assert image.getexif()[ExifTags.Base.Orientation] == 6


def test_the_callers_array_is_left_unchanged():
    image = picture()
    measure(image)
    assert np.array_equal(image, picture())
    assert image.flags.writeable


@pytest.mark.parametrize(
    ("array", "seen"),
    [
        pytest.param(np.zeros((80, 120), np.uint8), r"\(80, 120\) uint8", id="grey"),
        pytest.param(np.zeros((80, 120, 4), np.uint8), r"\(80, 120, 4\) uint8", id="alpha"),
        pytest.param(np.zeros((3, 80, 120), np.uint8), r"\(3, 80, 120\) uint8", id="planes first"),
        pytest.param(np.zeros((1, 80, 120, 3), np.uint8), r"\(1, 80, 120, 3\)", id="batch of one"),
        pytest.param(np.zeros((80, 120, 3)), r"\(80, 120, 3\) float64", id="float"),
        pytest.param(np.zeros((80, 120, 3), np.uint16), "uint16", id="16 bit"),
    ],
)
def test_an_array_that_is_no_rgb_picture_is_refused_with_its_shape(array, seen):
    with pytest.raises(ValueError, match=rf"`image` must be \(H, W, 3\) uint8 RGB; got .*{seen}"):
        measure(array)


@pytest.mark.parametrize("image", [None, 3, b"jpeg", [[[0, 0, 0]]], ims])
def test_what_is_no_picture_is_a_type_error(image):
    law = f"`image` must be a path, an array or a PIL image; got {type(image).__name__}"
    with pytest.raises(TypeError, match=law):
        measure(image)


def test_a_missing_file_is_a_file_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        measure(tmp_path / "nowhere.jpg")


@pytest.mark.parametrize("name", ["detector", "depth_source"])
def test_detector_and_depth_source_are_needed(name):
    options = {"detector": Recorder(), "depth_source": flat}
    del options[name]
    with pytest.raises(TypeError, match=name):
        ims.measure(picture(), **options)


# --- the chain ---


def test_sizes_follow_from_the_known_object_and_the_depths():
    result = measure(picture(), method="mean_ratio")
    # k = 2.0 / (4 x 50); the statue stands twice as far and spans as many pixels
    assert result.model.k == pytest.approx(0.01)
    assert [estimate.label for estimate in result.estimates] == ["door", "statue"]
    assert [estimate.size_m for estimate in result.estimates] == pytest.approx([2.0, 4.0])


def test_the_result_holds_what_was_seen():
    result = measure(picture())
    assert result.detections == (DOOR, STATUE)
    assert result.depth.kind == "relative"
    assert isinstance(result.estimates, tuple)
    assert result.model.priors == DOORS_ONLY
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        result.model = None


def test_measure_is_fit_and_predict():
    result = measure(picture())
    depth = two_distances(picture())
    model = ims.fit([DOOR, STATUE], depth, DOORS_ONLY)
    # as text, in which NaN is NaN
    assert repr(result.model) == repr(model)
    assert repr(list(result.estimates)) == repr(ims.predict(model, [DOOR, STATUE], depth))


def test_measuring_one_picture_twice_gives_equal_results():
    assert measure(picture()) == measure(picture())


def test_the_shipped_table_serves_where_no_priors_are_given():
    result = ims.measure(picture(), detector=Recorder(), depth_source=flat)
    assert result.model.priors == ims.PriorTable.default()


def test_axis_noise_and_prior_reach_fit_and_predict():
    noise = ims.Noise(box_px=3.0, depth_rel=0.2)
    result = measure(picture(), axis="width", noise=noise)
    assert {estimate.axis for estimate in result.estimates} == {"width"}
    assert result.model.noise == noise
    plain, fused = (measure(picture(), use_prior=flag).estimates[0] for flag in (False, True))
    assert ims.Flag.PRIOR_USED not in plain.flags
    assert ims.Flag.PRIOR_USED in fused.flags


def test_a_camera_gives_distances_in_metres():
    camera = ims.Camera(100.0, focal_rel_std=0.0, image_size=SIZE)
    result = measure(picture(), camera=camera, method="mean_ratio")
    # metres per pixel 0.04 and 0.08 at a focal length of 100 px
    assert [estimate.distance_m for estimate in result.estimates] == pytest.approx([4.0, 8.0])
    assert [estimate.distance_m for estimate in measure(picture()).estimates] == [None, None]


def test_a_camera_of_another_picture_is_refused():
    camera = ims.Camera(100.0, focal_rel_std=0.0, image_size=(1920, 1080))
    with pytest.raises(ValueError, match=r"`camera\.image_size` must be that of the image"):
        measure(picture(), camera=camera)


def test_a_smaller_depth_map_that_knows_the_picture_gives_the_same_sizes():
    def small(image):
        values = two_distances(image).values[::4, ::4]
        return ims.DepthMap(values, kind="relative", image_size=(image.shape[1], image.shape[0]))

    sizes = [e.size_m for e in measure(picture(), depth_source=small).estimates]
    assert sizes == pytest.approx([e.size_m for e in measure(picture()).estimates], rel=1e-9)


def test_depth_of_a_picture_of_another_size_is_refused_with_the_remedy():
    def small(image):  # forgot image_size; the door's box fits into it all the same
        return ims.DepthMap(two_distances(image).values[::2, ::2] / 2, kind="relative")

    small_door = ims.Detection("door", (5, 5, 15, 30))
    with pytest.raises(ValueError, match=r"120 x 80 px; got image_size=\(60, 40\)"):
        measure(picture(), detector=Recorder(small_door), depth_source=small)


def test_a_detector_may_yield_its_detections():
    def detector(_):
        yield DOOR
        yield STATUE

    assert measure(picture(), detector=detector).detections == (DOOR, STATUE)


def test_one_depth_per_detection_may_come_from_the_source():
    def source(_):
        return ims.ObjectDepths([4.0, 8.0], kind="relative")

    result = measure(picture(), depth_source=source, method="mean_ratio")
    assert [e.size_m for e in result.estimates] == pytest.approx([2.0, 4.0])


# --- refusals of what is plugged in ---


def test_nothing_detected_is_a_fit_error():
    with pytest.raises(ims.FitError, match="must hold at least one reference"):
        measure(picture(), detector=lambda image: [])  # noqa: ARG005


def test_only_unknown_objects_are_a_fit_error_naming_them():
    with pytest.raises(ims.FitError, match=r"statue \(no prior\)"):
        measure(picture(), detector=Recorder(STATUE))


def test_a_detector_that_returns_bare_boxes_is_refused():
    law = r"`detections` must hold Detection objects; got \(20, 10, 40, 60\) at index 0"
    with pytest.raises(TypeError, match=law):
        measure(picture(), detector=lambda image: [(20, 10, 40, 60)])  # noqa: ARG005


def test_a_depth_source_that_returns_an_array_is_refused_with_the_remedy():
    with pytest.raises(TypeError, match=r"got ndarray.*DepthMap\(values, kind=\.\.\.\)"):
        measure(picture(), depth_source=lambda image: np.ones(image.shape[:2]))


def test_boxes_beyond_the_picture_are_refused_with_the_remedy():
    beyond = ims.Detection("door", (20, 10, 400, 600))
    with pytest.raises(ValueError, match=r"must lie in the image, 120 x 80 px; got .*clip"):
        measure(picture(), detector=Recorder(beyond))


@pytest.mark.parametrize(
    ("option", "value"), [("axis", "length"), ("method", "magic")], ids=["axis", "method"]
)
def test_unknown_words_are_refused(option, value):
    with pytest.raises(ValueError, match=f"`{option}` must be one of .*; got '{value}'"):
        measure(picture(), **{option: value})


# --- what is handed on ---


def test_the_table_has_a_row_per_detection_in_any_unit():
    result = measure(picture())
    metres, feet = result.table(), result.table(unit="ft", level=0.5)
    assert [row["label"] for row in metres] == ["door", "statue"]
    for row, other, size in zip(metres, feet, result.estimates, strict=True):
        assert row["size_m"] == size.size_m
        assert (row["low_m"], row["high_m"]) == size.interval(0.9)
        assert other["size_ft"] == pytest.approx(size.size_m / 0.3048, rel=1e-12)
        assert other["low_ft"] == pytest.approx(size.interval(0.5)[0] / 0.3048, rel=1e-12)
    assert metres[0]["flags"].split() == ["REFERENCE", *metres[0]["flags"].split()[1:]]
    assert [metres[1][name] for name in ("x1", "y1", "x2", "y2")] == [60, 20, 90, 70]


def test_what_is_not_known_is_none_in_the_table_and_a_dash_in_print():
    source = ims.ObjectDepths([4.0, np.nan], kind="relative")
    result = measure(picture(), depth_source=lambda _: source)
    row = result.table()[1]
    assert (row["size_m"], row["low_m"], row["distance_m"]) == (None, None, None)
    assert str(result).splitlines()[-1].split() == ["statue", "unknown", "-", "-", "NO_DEPTH"]


def test_an_unknown_unit_is_refused():
    with pytest.raises(ValueError, match=r"`unit` must be one of .*; got 'yard'"):
        measure(picture()).table(unit="yard")


def test_the_record_of_a_measurement_is_plain_json_and_rebuilds_its_model(tmp_path):
    path = tmp_path / "photo.png"
    Image.fromarray(picture()).save(path)
    result = measure(path)
    record = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert record["name"] == str(path)
    assert record["image_size"] == [120, 80]
    assert record["objects"] == result.table()
    assert ims.ScaleModel.from_dict(record["model"]) == result.model


def test_an_array_has_no_name():
    assert measure(picture()).name == ""


def test_a_pair_of_another_length_is_refused():
    depth = flat(picture())
    for pair in ((depth,), (depth, None, None)):
        with pytest.raises(TypeError, match=r"a pair of depth and camera; got a tuple of \d"):
            measure(picture(), depth_source=lambda _, pair=pair: pair)


def test_a_picture_beyond_what_pillow_opens_is_refused_with_the_remedy(tmp_path, monkeypatch):
    path = tmp_path / "large.png"
    Image.fromarray(picture()).save(path)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    with pytest.raises(ValueError, match=r"too large to be opened: .*MAX_IMAGE_PIXELS"):
        measure(path)


def test_the_level_of_a_table_without_rows_is_checked_too():
    empty = attrs.evolve(measure(picture()), estimates=(), detections=())
    with pytest.raises(ValueError, match="`level` must be"):
        empty.table(level=7)


@pytest.mark.parametrize("name", sorted(set(ims.__all__) - {"Depth"}))
def test_the_types_of_every_public_name_can_be_looked_up(name):
    typing.get_type_hints(getattr(ims, name))


def test_a_detector_that_returns_nothing_is_named():
    with pytest.raises(
        TypeError, match=r"`detector` must be or return a sequence .* an empty one where"
    ):
        measure(picture(), detector=lambda _: None)


def test_a_map_that_was_transposed_is_named_as_such():
    with pytest.raises(ValueError, match=r"as upright as the picture.*Transpose the map"):
        measure(picture(), depth_source=lambda _: ims.DepthMap(np.ones((120, 80)), kind="relative"))


def test_reservations_about_the_scale_are_in_print_and_in_the_table():
    near, far = ims.Detection("door", (5, 5, 25, 55)), ims.Detection("door", (70, 5, 80, 20))
    result = measure(picture(), detector=lambda _: [near, far, STATUE], depth_source=flat)
    assert ims.Flag.INCONSISTENT in result.model.flags
    assert "reservations, see explain(): " in str(result)
    assert "INCONSISTENT" in result.table()[2]["model_flags"].split()
