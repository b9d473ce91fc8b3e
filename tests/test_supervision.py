"""Detections, sizes and depth maps to and from the real supervision."""

import copy
import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import imgscale as ims
from imgscale.datasets import motorcycle
from imgscale.depth_sources import supervision as depths
from imgscale.detectors import supervision as boxes
from imgscale.detectors.supervision import from_supervision, to_supervision, with_sizes


@pytest.fixture
def sv():
    return pytest.importorskip("supervision", reason="supervision is not installed")


def stand_in(count=2, **changes):
    fields = {
        "xyxy": np.array([[10.0 * i, 20.0, 10.0 * i + 50, 90.0] for i in range(count)]),
        "mask": None,
        "confidence": None,
        "class_id": np.arange(count),
        "tracker_id": None,
        "data": {},
    }
    return SimpleNamespace(**{**fields, **changes})


def an_estimate(size_m=1.5, std_m=0.06, axis="height", label="car"):
    return ims.SizeEstimate(
        label=label,
        axis=axis,
        size_m=size_m,
        std_m=std_m,
        metres_per_pixel=0.01,
        depth=7.0,
        distance_m=None,
        flags=ims.Flag(0),
    )


def two_masks():
    masks = np.zeros((2, 100, 120), dtype=np.bool_)
    masks[0, 30:60, 5:40] = True
    masks[1, 25:80, 15:50] = True
    return masks


# --- detections of supervision read ---


def test_names_boxes_scores_and_tracks_are_read_from_the_real_thing(sv):
    found = from_supervision(
        sv.Detections(
            xyxy=np.array([[0.1, 20, 110.7, 70], [5, 6, 7, 8]], dtype=np.float32),
            confidence=np.array([0.9, 0.3], dtype=np.float32),
            class_id=np.array([7, 2]),
            tracker_id=np.array([31, 4]),
            data={"class_name": np.array(["truck", "car"])},
        )
    )
    assert [(d.label, type(d.label)) for d in found] == [("truck", str), ("car", str)]
    assert found[0].xyxy == (float(np.float32(0.1)), 20.0, float(np.float32(110.7)), 70.0)
    assert [d.score for d in found] == [float(np.float32(0.9)), float(np.float32(0.3))]
    assert [(d.track_id, type(d.track_id)) for d in found] == [(31, int), (4, int)]


def test_a_result_that_supervision_reads_itself_comes_through(sv):
    prediction = {"x": 60.0, "y": 45.0, "width": 100.0, "height": 50.0, "confidence": 0.75}
    result = {
        "predictions": [{**prediction, "class": "car", "class_id": 2}],
        "image": {"width": 640, "height": 480},
    }
    (car,) = from_supervision(sv.Detections.from_inference(result))
    assert (car.label, car.xyxy, car.score) == ("car", (10.0, 20.0, 110.0, 70.0), 0.75)


def test_an_empty_result_gives_no_detection(sv):
    assert from_supervision(sv.Detections.empty()) == []
    assert from_supervision(sv.Detections.empty(), class_names=["car"]) == []


def test_a_filtered_result_is_read_in_its_order(sv):
    detections = sv.Detections(
        xyxy=np.array([[0, 0, 9, 9], [1, 1, 8, 8], [2, 2, 7, 7]]),
        class_id=np.array([0, 1, 0]),
        data={"class_name": ["a", "b", "c"]},
    )
    assert [d.label for d in from_supervision(detections[[2, 0]])] == ["c", "a"]


@pytest.mark.parametrize("names", [{0: "car", 1: "bus"}, ["car", "bus"], ("car", "bus")])
def test_class_names_name_the_class_ids(sv, names):
    detections = sv.Detections(
        xyxy=np.array([[0, 0, 9, 9], [1, 1, 8, 8]]), class_id=np.array([1, 0])
    )
    assert [d.label for d in from_supervision(detections, class_names=names)] == ["bus", "car"]


def test_the_names_of_the_data_come_first():
    found = stand_in(1, data={"class_name": ["van"]})
    assert from_supervision(found, class_names=["car"])[0].label == "van"


def test_class_ids_may_be_whole_floats():
    found = stand_in(2, class_id=np.array([1.0, 0.0], dtype=np.float32))
    assert [d.label for d in from_supervision(found, class_names=["car", "bus"])] == ["bus", "car"]


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int16, np.uint8, object])
def test_boxes_of_any_number_type_keep_their_values(dtype):
    found = stand_in(1, xyxy=np.array([[1, 2, 30, 40]], dtype=dtype).astype(dtype))
    if dtype is object:
        with pytest.raises(ValueError, match=r"detections\[0\]: `xyxy` must be four numbers"):
            from_supervision(found, class_names=["car"])
    else:
        assert from_supervision(found, class_names=["car"])[0].xyxy == (1.0, 2.0, 30.0, 40.0)


def test_without_confidence_the_score_is_one():
    assert from_supervision(stand_in(1), class_names=["car"])[0].score == 1.0


def test_a_negative_track_is_none():
    found = stand_in(3, tracker_id=np.array([-1, 0, 5]))
    tracks = [d.track_id for d in from_supervision(found, class_names=["a", "b", "c"])]
    assert tracks == [None, 0, 5]


def test_boxes_are_cut_where_the_size_is_known_and_only_there():
    found = stand_in(1, xyxy=np.array([[-4.5, 2.0, 30.0, 40.0]]))
    assert from_supervision(found, class_names=["car"])[0].xyxy[0] == -4.5
    cut = from_supervision(found, class_names=["car"], image_size=(20, 30))
    assert cut[0].xyxy == (0.0, 2.0, 20.0, 30.0)


def test_masks_are_read_dense_and_compact_alike(sv):
    masks, xyxy = two_masks(), np.array([[5, 30, 40, 60], [15, 25, 50, 80]])
    names = {"class_name": np.array(["a", "b"])}
    packed = sv.CompactMask.from_dense(masks, xyxy, image_shape=(100, 120))
    dense = from_supervision(sv.Detections(xyxy=xyxy, mask=masks, data=names))
    compact = from_supervision(sv.Detections(xyxy=xyxy, mask=packed, data=names))
    assert compact == dense
    np.testing.assert_array_equal(np.stack([d.mask for d in dense]), masks)


def test_read_only_input_is_read_and_left_as_it_was():
    found = stand_in(2, mask=two_masks(), confidence=np.array([0.5, 1.0], dtype=np.float32))
    for array in (found.xyxy, found.mask, found.confidence, found.class_id):
        array.flags.writeable = False
    before = copy.deepcopy(found)
    made = from_supervision(found, class_names=["a", "b"])
    np.testing.assert_array_equal(found.xyxy, before.xyxy)
    assert not np.shares_memory(made[0].mask, found.mask)


@pytest.mark.parametrize(
    ("found", "names", "error", "message"),
    [
        pytest.param(
            [], None, TypeError, "must be one supervision.Detections; got list", id="list"
        ),
        pytest.param(stand_in(1), None, ValueError, "class ids alone.*class_names", id="no names"),
        pytest.param(
            stand_in(1, class_id=None), ["car"], ValueError, "got neither", id="no class ids"
        ),
        pytest.param(
            stand_in(2),
            ["car"],
            ValueError,
            r"name class 1 of detections\[1\]; got names for 0\.",
            id="unnamed class",
        ),
        pytest.param(
            stand_in(1, class_id=np.array([-1])), ["car"], ValueError, "name class -1", id="minus 1"
        ),
        pytest.param(
            stand_in(1, class_id=np.array([np.nan])), {}, ValueError, "for none", id="nan class"
        ),
        pytest.param(stand_in(1), "car", TypeError, "got the string 'car'", id="one string"),
        pytest.param(
            stand_in(1, data={"class_name": [None]}),
            None,
            TypeError,
            r"detections\[0\]: `label` must be a string; got None",
            id="none as name",
        ),
        pytest.param(
            stand_in(2, data={"class_name": ["car"]}),
            None,
            ValueError,
            "one `class_name` for each of 2 boxes; got 1",
            id="too few names",
        ),
        pytest.param(
            stand_in(2, confidence=np.ones(3)),
            ["a", "b"],
            ValueError,
            "one `confidence` for each of 2 boxes; got 3",
            id="too many scores",
        ),
        pytest.param(
            stand_in(1, confidence=np.array([85.0])),
            ["car"],
            ValueError,
            r"detections\[0\]: `score` must be between 0 and 1; got 85",
            id="percent",
        ),
        pytest.param(
            stand_in(1, mask=two_masks()[:1].astype(np.uint8)),
            ["car"],
            TypeError,
            r"detections\[0\]: `mask` must be boolean",
            id="bytes as mask",
        ),
        pytest.param(
            stand_in(2, xyxy=np.array([[0, 0, 5, 5], [5, 5, 5, 9]])),
            ["a", "b"],
            ValueError,
            r"detections\[1\]: `xyxy` must have x1 < x2",
            id="flat box",
        ),
        pytest.param(
            stand_in(1, tracker_id=np.array([1.5])),
            ["car"],
            ValueError,
            r"detections\[0\]: `tracker_id` must be a whole number; got 1.5",
            id="half a track",
        ),
    ],
)
def test_what_cannot_be_a_detection_is_refused_by_its_place(found, names, error, message):
    with pytest.raises(error, match=message):
        from_supervision(found, class_names=names)


# --- detections written ---

OURS = (
    ims.Detection("car", (10.1, 20.2, 110.3, 70.4), score=1 / 3, track_id=8),
    ims.Detection("person", (0, 0, 50, 60), score=0.5, track_id=3),
    ims.Detection("car", (5, 6, 7, 8), track_id=0),
)


def test_detections_come_back_from_supervision_as_they_went(sv):
    theirs = to_supervision(OURS)
    assert isinstance(theirs, sv.Detections)
    assert from_supervision(theirs) == list(OURS)


@pytest.mark.usefixtures("sv")
def test_class_ids_number_the_labels_as_they_first_appear():
    assert to_supervision(OURS).class_id.tolist() == [0, 1, 0]


@pytest.mark.usefixtures("sv")
def test_masks_come_back_from_supervision():
    masks = two_masks()
    ours = [
        ims.Detection("a", (5, 30, 40, 60), mask=masks[0]),
        ims.Detection("b", (15, 25, 50, 80), mask=masks[1]),
    ]
    theirs = to_supervision(ours)
    assert theirs.area.tolist() == masks.sum(axis=(1, 2)).tolist()
    assert from_supervision(theirs) == ours


def test_no_detections_make_empty_detections(sv):
    theirs = to_supervision([])
    assert theirs.is_empty()
    assert theirs.xyxy.shape == (0, 4)
    assert from_supervision(theirs) == []
    assert len(sv.Detections.merge([theirs, to_supervision(OURS)])) == 3


@pytest.mark.parametrize("tracks", [(None, None), ("a", "b"), (1, "b"), ("a", None)])
@pytest.mark.usefixtures("sv")
def test_track_ids_are_written_only_where_there_are_some_and_none_is_a_name(tracks):
    ours = [ims.Detection("car", (0, 0, 5, 5), track_id=track) for track in tracks]
    assert to_supervision(ours).tracker_id is None


@pytest.mark.usefixtures("sv")
def test_a_detection_that_is_not_tracked_keeps_the_others_tracks():
    ours = [ims.Detection("car", (0, 0, 5, 5), track_id=track) for track in (8, None, 0)]
    theirs = to_supervision(ours)
    assert theirs.tracker_id.tolist() == [8, -1, 0]
    assert from_supervision(theirs) == ours


@pytest.mark.usefixtures("sv")
def test_masks_of_some_or_of_several_shapes_are_refused():
    masked = ims.Detection("a", (0, 0, 5, 5), mask=np.ones((6, 6), dtype=np.bool_))
    other = ims.Detection("a", (0, 0, 5, 5), mask=np.ones((6, 7), dtype=np.bool_))
    with pytest.raises(ValueError, match="all have masks or none; got none at index 1"):
        to_supervision([masked, OURS[0]])
    with pytest.raises(ValueError, match=r"one shape; got \(6, 6\) and \(6, 7\)"):
        to_supervision([masked, other])


def test_only_detections_are_written():
    with pytest.raises(TypeError, match="`detections` must hold Detection objects"):
        to_supervision([(0, 0, 5, 5)])


# --- sizes written ---


@pytest.mark.usefixtures("sv")
def test_sizes_are_columns_that_supervision_filters_with_the_boxes():
    theirs = to_supervision(OURS)
    sized = with_sizes(theirs, [an_estimate(1.4), an_estimate(1.7), an_estimate(0.2)])
    small = sized[sized.data["height_m"] < 1.5]
    assert small["class_name"].tolist() == ["car", "car"]
    assert small["height_m"].tolist() == [1.4, 0.2]


@pytest.mark.usefixtures("sv")
def test_intervals_are_those_of_the_estimates_at_the_level_asked_for():
    estimates = [an_estimate(1.4), an_estimate(1.7, 0.4), an_estimate(0.2, 0.01)]
    data = with_sizes(to_supervision(OURS), estimates, level=0.5).data
    ends = list(zip(data["height_low_m"], data["height_high_m"], strict=True))
    assert ends == [estimate.interval(0.5) for estimate in estimates]
    # 0.6745 standard deviations of the logarithm hold the middle half
    assert ends[1] == pytest.approx((1.7 * math.exp(-0.15870), 1.7 * math.exp(0.15870)), rel=1e-4)


def test_the_originals_stay_as_they_were(sv):
    theirs = to_supervision(OURS[:1])
    sized = with_sizes(theirs, [an_estimate()])
    assert list(theirs.data) == ["class_name"]
    assert list(sized.data) == ["class_name", "height_m", "height_low_m", "height_high_m"]
    assert isinstance(sized, sv.Detections)


def test_an_unknown_size_is_nan():
    data = with_sizes(stand_in(1), [an_estimate(math.nan, math.nan)]).data
    assert {name: math.isnan(column[0]) for name, column in data.items()} == dict.fromkeys(
        ("height_m", "height_low_m", "height_high_m"), True
    )


def test_each_axis_has_columns_of_its_own():
    data = with_sizes(stand_in(2), [an_estimate(1.5), an_estimate(0.4, axis="diameter")]).data
    np.testing.assert_array_equal(data["height_m"], [1.5, np.nan])
    np.testing.assert_array_equal(data["diameter_m"], [np.nan, 0.4])
    assert len(data) == 6


def test_a_picture_without_objects_has_the_columns_too(sv):
    sized = with_sizes(sv.Detections.empty(), [])
    assert {name: len(sized.data[name]) for name in sized.data} == {
        "height_m": 0,
        "height_low_m": 0,
        "height_high_m": 0,
    }
    assert sized.is_empty()


def test_columns_have_the_type_of_floats():
    assert {column.dtype for column in with_sizes(stand_in(1), [an_estimate()]).data.values()} == {
        np.dtype(np.float64)
    }


@pytest.mark.parametrize(
    ("found", "estimates", "level", "error", "message"),
    [
        (stand_in(2), [an_estimate()], 0.9, ValueError, "each of the 2 detections; got 1"),
        (stand_in(1), [1.5], 0.9, TypeError, "`estimates` must be a SizeEstimate; got float"),
        (stand_in(1), 1.5, 0.9, TypeError, "`estimates` must be a sequence"),
        (stand_in(1), [an_estimate()], 90, ValueError, "`level` must be above 0 and below 1"),
        (np.zeros((1, 4)), [an_estimate()], 0.9, TypeError, "one supervision.Detections"),
    ],
)
def test_sizes_that_do_not_belong_are_refused(found, estimates, level, error, message):
    with pytest.raises(error, match=message):
        with_sizes(found, estimates, level=level)


# --- depth maps ---


@pytest.fixture
def scene():
    return motorcycle.load()


@pytest.fixture
def disparity(scene):
    return (scene.shifted_disparity - 31.086).astype(np.float32)


@pytest.fixture
def stereo(sv):
    return sv.DepthCamera(fx_px=994.978, baseline_m=0.193001, doffs_px=31.086)


def test_disparity_with_a_camera_is_the_metric_depth_that_supervision_computes(
    sv, disparity, stereo
):
    theirs = sv.DepthMap(disparity, kind="disparity_px", camera=stereo)
    ours = depths.from_supervision(theirs)
    assert (ours.kind, ours.image_size) == ("metric", (741, 500))
    np.testing.assert_allclose(ours.values, theirs.to_depth().to_float(), rtol=1e-6)


def test_disparity_that_supervision_takes_for_none_has_no_depth(sv, stereo):
    values = np.array([[-5.0, 0.0, np.nan, np.inf, 10.0]], dtype=np.float32)
    for camera in (stereo, None):
        ours = depths.from_supervision(sv.DepthMap(values, kind="disparity_px", camera=camera))
        assert np.isfinite(ours.values).tolist() == [[False, False, False, False, True]]


def test_disparity_without_a_camera_is_inverse_depth_up_to_a_shift_too(sv, disparity):
    ours = depths.from_supervision(sv.DepthMap(disparity, kind="disparity_px"))
    assert ours.kind == "affine_inverse"
    np.testing.assert_array_equal(ours.values, disparity)


def test_the_shift_that_disparity_lacks_is_found_by_two_known_objects(sv, disparity, scene):
    # Without doffs, the tyre and the tall carton still give the carton its size.
    truth = ims.fit(scene.detections, scene.depth, scene.priors, noise=scene.noise)
    sizes = ims.predict(truth, scene.detections, scene.depth)
    tall = ims.ObjectPrior("tall carton", sizes[5].size_m, 0.002)
    ours = depths.from_supervision(sv.DepthMap(disparity, kind="disparity_px"))
    model = ims.fit(scene.detections, ours, scene.priors.with_prior(tall), noise=scene.noise)
    found = ims.predict(model, scene.detections, ours)
    assert found[4].size_m == pytest.approx(sizes[4].size_m, rel=0.01)
    assert abs(model.shift - 31.086) < 2 * model.shift_std
    naive = ims.DepthMap(disparity, kind="inverse")
    wrong = ims.fit(scene.detections[:1], naive, scene.priors, noise=scene.noise)
    (carton,) = ims.predict(wrong, scene.detections[4:5], naive)
    assert carton.size_m > 1.3 * sizes[4].size_m


def test_metres_keep_their_values_and_what_is_no_depth_becomes_nan(sv):
    values = np.array([[2.5, 0.0, -1.0, np.inf, np.nan, 1e-3]], dtype=np.float32)
    ours = depths.from_supervision(sv.DepthMap(values, kind="depth_m"), scale_rel_std=0.15)
    assert (ours.kind, ours.scale_rel_std, ours.values.dtype) == ("metric", 0.15, np.float32)
    expected = np.array([[2.5, np.nan, np.nan, np.nan, np.nan, 1e-3]], dtype=np.float32)
    np.testing.assert_array_equal(ours.values, expected)


def test_relative_inverse_keeps_its_zero_and_loses_what_is_below(sv):
    values = np.array([[0.0, 0.5, -0.1, np.nan]], dtype=np.float32)
    ours = depths.from_supervision(sv.DepthMap(values, kind="relative_inverse"))
    assert ours.kind == "affine_inverse"
    expected = np.array([[0.0, 0.5, np.nan, np.nan]], dtype=np.float32)
    np.testing.assert_array_equal(ours.values, expected)


def test_the_size_of_the_picture_and_the_error_of_the_scale_are_taken_on(sv, disparity, stereo):
    theirs = sv.DepthMap(disparity, kind="disparity_px", camera=stereo)
    ours = depths.from_supervision(theirs, image_size=(2964, 2000), scale_rel_std=0.02)
    assert (ours.image_size, ours.scale_rel_std) == ((2964, 2000), 0.02)


def test_a_map_of_supervision_is_copied(sv):
    values = np.full((4, 5), 2.0, dtype=np.float32)
    theirs = sv.DepthMap(values, kind="depth_m")
    ours = depths.from_supervision(theirs)
    theirs.values[:] = 7.0
    assert (ours.values == 2.0).all()


@pytest.mark.parametrize(
    ("theirs", "error", "message"),
    [
        (np.ones((2, 2)), TypeError, "supervision.DepthMap; got ndarray. Arrays go through"),
        (
            SimpleNamespace(kind="sonar", camera=None, to_float=lambda: np.ones((2, 2))),
            ValueError,
            "one of depth_m, disparity_px, relative_inverse; got 'sonar'",
        ),
        (
            SimpleNamespace(kind="depth_m", camera=None, to_float=lambda: np.full((2, 2), np.nan)),
            ValueError,
            '"metric" map is empty',
        ),
    ],
)
def test_what_is_no_depth_map_is_refused(theirs, error, message):
    with pytest.raises(error, match=message):
        depths.from_supervision(theirs)


def test_metric_depth_comes_back_from_supervision(sv):
    ours = ims.DepthMap(np.array([[2.5, np.nan, 0.0, 1 / 3]]), kind="metric")
    theirs = depths.to_supervision(ours)
    assert theirs.kind is sv.DepthKind.DEPTH_M
    back = depths.from_supervision(theirs)
    np.testing.assert_array_equal(
        back.values, np.array([[2.5, np.nan, np.nan, 1 / 3]], dtype=np.float32)
    )


def test_inverse_depth_without_a_value_has_none_in_supervision_either(sv):
    ours = ims.DepthMap(np.array([[0.5, 0.0, -1.0, 2.0]]), kind="inverse")
    theirs = depths.to_supervision(ours)
    assert theirs.kind is sv.DepthKind.RELATIVE_INVERSE
    assert theirs.valid_mask.tolist() == [[True, False, False, True]]
    assert theirs.values[0, [0, 3]].tolist() == [0.5, 2.0]


@pytest.mark.usefixtures("sv")
def test_affine_inverse_depth_is_shifted_only_where_supervision_would_lose_it():
    shifted = depths.to_supervision(ims.DepthMap(np.array([[-2.0, 1.0]]), kind="affine_inverse"))
    kept = depths.to_supervision(ims.DepthMap(np.array([[0.5, 1.0]]), kind="affine_inverse"))
    assert shifted.values.tolist() == [[0.0, 3.0]]
    assert shifted.valid_mask.all()
    assert kept.values.tolist() == [[0.5, 1.0]]


def test_relative_depth_is_refused_with_its_remedy():
    with pytest.raises(ValueError, match=r'"relative".*model\.to_metric\(depth, camera\)'):
        depths.to_supervision(ims.DepthMap([[1.0]], kind="relative"))


def test_only_maps_are_written():
    with pytest.raises(TypeError, match="`depth` must be a DepthMap; got ObjectDepths"):
        depths.to_supervision(ims.ObjectDepths([1.0], kind="metric"))


# --- both together ---


def test_the_motorcycle_is_measured_from_supervision_to_supervision(sv, disparity, stereo, scene):
    # By hand, with supervision's own medians: k = 0.622 m / (165 px x 2.5764 m).
    theirs = to_supervision(scene.detections)
    depth_map = sv.DepthMap(disparity, kind="disparity_px", camera=stereo)
    medians = depth_map.measure_detections(theirs).data["depth_m"].astype(float)
    heights = theirs.xyxy[:, 3] - theirs.xyxy[:, 1]
    by_hand = 0.622 * heights * medians / (heights[0] * medians[0])

    found, depth = from_supervision(theirs), depths.from_supervision(depth_map)
    model = ims.fit(found, depth, scene.priors, noise=scene.noise)
    sized = with_sizes(theirs, ims.predict(model, found, depth))
    np.testing.assert_allclose(sized["height_m"], by_hand, rtol=0.025)
    assert (sized["height_low_m"] < sized["height_m"]).all()
    assert (sized["height_m"] < sized["height_high_m"]).all()


def test_reading_imports_nothing_of_supervision():
    code = (
        "import sys; import imgscale.detectors.supervision, imgscale.depth_sources.supervision; "
        "sys.exit('supervision' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_writing_says_what_to_install_where_supervision_is_absent(monkeypatch):
    monkeypatch.setitem(sys.modules, "supervision", None)
    with pytest.raises(ims.MissingDependencyError, match=r"'imgscale\[supervision\]'"):
        boxes.to_supervision(OURS)
    with pytest.raises(ims.MissingDependencyError, match=r"'imgscale\[supervision\]'"):
        depths.to_supervision(ims.DepthMap([[1.0]], kind="metric"))
