"""Inputs that would give a plausible wrong number, each with its flag or refusal."""

import math

import numpy as np
import pytest
from PIL import Image

import imgscale as ims
from imgscale import Flag
from imgscale.core.estimator import disagree, fit_robust
from imgscale.core.segments import LogObservations

POLE = ims.PriorTable([ims.ObjectPrior("pole", 2.0, 0.1)])


def box(label, height, left=20.0, top=20.0, width=40.0, **options):
    return ims.Detection(label, (left, top, left + width, top + height), **options)


@pytest.mark.parametrize("method", ["robust", "posterior"])
def test_a_calibrated_camera_is_not_overruled_by_one_mislabelled_object(method):
    # a van of 3.2 m called "pole" of 2.0 m; the depth is exact and the camera calibrated
    camera = ims.Camera(1000.0, focal_rel_std=0.0)
    van, thing = box("pole", 320.0), box("thing", 100.0, left=200.0)
    depth = ims.ObjectDepths([10.0, 10.0], kind="metric", rel_std=0.0)
    model = ims.fit([van, thing], depth, POLE, camera=camera, method=method)
    assert ims.predict(model, [van, thing], depth)[1].size_m == pytest.approx(1.0, rel=1e-4)
    assert Flag.CAMERA_CONFLICT in model.flags


def test_a_firm_witness_keeps_its_declared_error_whatever_the_others_say():
    y = np.array([-6.0, -4.0, -8.0, -7.0])
    obs = LogObservations(
        y=y, variance=np.array([0.01, 0.01, 0.01, 1e-6]), tau=np.zeros(4),
        image=np.zeros(4, dtype=np.intp), group=np.arange(4),
        firm=np.array([False, False, False, True]),
    )  # fmt: skip
    fitted = fit_robust(obs)
    assert fitted.trust[-1] == 1
    assert fitted.weight[-1] == pytest.approx(1e6)
    assert fitted.log_k[0] == pytest.approx(-7.0, abs=1e-3)


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares", "robust", "posterior"])
def test_a_stale_focal_length_is_reported_by_every_method(method):
    detections = [box("pole", 1000 * 2 / z, left=60.0 * z) for z in (5.0, 8.0, 10.0)]
    depth = ims.ObjectDepths([5.0, 8.0, 10.0], kind="metric", rel_std=0.01)
    for focal_px, conflicts in ((1000.0, False), (700.0, True)):
        camera = ims.Camera(focal_px, focal_rel_std=0.01)
        model = ims.fit(detections, depth, POLE, camera=camera, method=method)
        assert (Flag.CAMERA_CONFLICT in model.flags) == conflicts


def test_exact_metric_depth_is_the_distance_whatever_the_focal_length_says():
    camera = ims.Camera(1060.0, focal_rel_std=0.04)
    depth = ims.ObjectDepths([10.0], kind="metric")
    for method in ("mean_ratio", "robust", "posterior"):
        model = ims.fit([box("pole", 200.0)], depth, POLE, camera=camera, method=method)
        assert ims.predict(model, [box("thing", 50.0)], depth)[0].distance_m == 10.0


def test_millimetres_are_noticed_without_the_size_of_the_image():
    detections = [box("pole", 1000 * 2 / z, left=60.0 * z) for z in (5.0, 8.0)]
    for unit, implausible in ((1.0, False), (1000.0, True)):
        depth = ims.ObjectDepths(np.array([5.0, 8.0]) * unit, kind="metric")
        model = ims.fit(detections, depth, POLE)
        assert (Flag.IMPLAUSIBLE_FOCAL in model.flags) == implausible


def test_a_focal_length_in_millimetres_is_noticed():
    depth = ims.ObjectDepths([5.0], kind="inverse", image_size=(4000, 3000))
    for focal_px, implausible in ((3000.0, False), (4.25, True)):
        camera = ims.Camera(focal_px, focal_rel_std=0.0)
        model = ims.fit([box("pole", 400.0)], depth, POLE, camera=camera)
        assert (Flag.IMPLAUSIBLE_FOCAL in model.flags) == implausible


def test_integer_arrays_of_object_depths_are_refused_as_metric_and_numbers_by_hand_are_not():
    with pytest.raises(ValueError, match=r"got dtype uint16.*millimetres 1000"):
        ims.ObjectDepths(np.array([2500], dtype=np.uint16), kind="metric")
    assert ims.ObjectDepths([4, 5], kind="metric").values.tolist() == [4.0, 5.0]
    assert ims.ObjectDepths(np.array([4, 5]), kind="relative").values.tolist() == [4.0, 5.0]


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_masked_pixels_have_no_depth(dtype):
    values = np.ma.masked_equal(np.array([[3, 99], [3, 99]], dtype=dtype), 99)
    depth = ims.DepthMap(values, kind="relative", image_size=(200, 200))
    table = ims.PriorTable([ims.ObjectPrior("pole", 2.0, 0.1)])
    left, right = box("pole", 100.0, top=50.0), box("thing", 100.0, left=120.0, top=50.0)
    model = ims.fit([left], depth, table)
    found, missing = ims.predict(model, [left, right], depth)
    assert found.depth == 3.0
    assert math.isnan(missing.size_m)
    assert Flag.NO_DEPTH in missing.flags


def test_the_shape_of_the_map_is_not_its_image_size():
    with pytest.raises(ValueError, match=r"height, width.*Pass \(640, 480\)"):
        ims.DepthMap(np.ones((480, 640)), kind="relative", image_size=(480, 640))
    camera = ims.Camera(500.0, focal_rel_std=0.0, image_size=(480, 640))
    with pytest.raises(ValueError, match=r"Pass \(640, 480\)"):
        ims.DepthMap.from_ray_distance(np.ones((480, 640)), camera)
    assert ims.DepthMap(np.ones((9, 9)), kind="relative", image_size=(9, 9)).image_size == (9, 9)


def test_a_small_mask_in_a_large_box_is_found():
    values = np.full((1500, 2000), 20.0)
    values[1000:1010, 1500:1510] = 5.0
    mask = values == 5.0
    depth = ims.DepthMap(values, kind="relative")
    thing = ims.Detection("thing", (50, 50, 1950, 1450), mask=mask)
    model = ims.fit([box("pole", 200.0)], depth, POLE)
    assert ims.predict(model, [thing], depth)[0].depth == 5.0


def test_a_mask_of_another_size_than_the_image_is_refused_without_a_map_too():
    pole = box("pole", 10.0, left=2.0, top=2.0, width=5.0, mask=np.ones((20, 20), dtype=bool))
    depth = ims.ObjectDepths([4.0], kind="relative", image_size=(640, 480))
    with pytest.raises(ValueError, match=r"shape of the image, \(480, 640\); got \(20, 20\)"):
        ims.fit([pole], depth, POLE)


def test_the_prior_of_a_whole_object_is_not_fused_with_a_part_of_it():
    depth = ims.ObjectDepths([10.0, 10.0], kind="relative", rel_std=0.01)
    detections = [box("pole", 200.0), box("pole", 100.0, left=200.0, partial=True)]
    model = ims.fit(detections, depth, POLE)
    part = ims.predict(model, detections, depth, use_prior=True)[1]
    assert part.flags == Flag.PARTIAL
    assert part.size_m == pytest.approx(1.0, rel=0.01)


def test_a_reference_with_two_surfaces_leaves_its_trace_in_the_model():
    values = np.full((200, 200), 8.0)
    values[:, 90:100] = 2.0  # a post before half of the pole's core
    depth = ims.DepthMap(values, kind="relative")
    model = ims.fit([box("pole", 100.0, left=80.0, top=50.0)], depth, POLE)
    assert Flag.MIXED_DEPTH in model.flags
    assert model.references[0].mixed


def test_objects_at_one_depth_say_nothing_of_the_scatter_of_depths():
    depth = ims.ObjectDepths([10.0, 10.0], kind="relative")
    detections = [box("pole", 200.0), box("pole", 210.0, left=200.0)]
    model = ims.fit(detections, depth, POLE)
    with pytest.raises(ims.FitError, match=r"different depths.*got 2 at 10"):
        ims.predict(model, [box("thing", 50.0)], "mean")


def test_a_resized_picture_is_not_measured_with_the_model_of_the_full_one():
    full = ims.ObjectDepths([10.0], kind="metric", image_size=(800, 600))
    half = ims.ObjectDepths([10.0], kind="metric", image_size=(400, 300))
    model = ims.fit([box("pole", 200.0)], full, POLE)
    with pytest.raises(ims.DepthMismatchError, match=r"\(800, 600\); got \(400, 300\)"):
        ims.predict(model, [box("thing", 50.0)], half)


def test_a_picture_of_sixteen_bits_is_not_clipped(tmp_path):
    path = tmp_path / "deep.png"
    Image.fromarray(np.full((20, 30), 40_000, dtype=np.uint16)).save(path)
    with pytest.raises(ValueError, match='8 bits per channel; got mode "I'):
        ims.measure(path, detector=lambda _: [], depth_source=lambda _: None)


def test_a_detector_that_draws_changes_nobody_elses_picture():
    picture = np.zeros((100, 100, 3), dtype=np.uint8)
    seen = []

    def detector(image):
        image[:] = 255
        return [box("pole", 50.0)]

    def depth_source(image):
        seen.append(int(image.max()))
        return ims.DepthMap(np.full((100, 100), 4.0), kind="relative")

    ims.measure(picture, detector=detector, depth_source=depth_source, priors=POLE)
    assert (int(picture.max()), seen) == (0, [0])


@pytest.mark.parametrize(
    ("call", "message"),
    [  # called with detections and a model
        (lambda d, m: ims.fit(d, m.priors), "`depth` must be a DepthMap"),
        (lambda d, _: ims.fit(d[0], ims.ObjectDepths([1.0], kind="relative")), "in a list"),
        (lambda *_: ims.fit(None, ims.ObjectDepths([1.0], kind="relative")), "got NoneType"),
        (lambda *_: ims.PriorTable(ims.ObjectPrior("pole", 1, 0)), "in a list"),
        (ims.predict, "`model` must be a ScaleModel"),
        (lambda *_: ims.Frame(5, ims.ObjectDepths([1.0], kind="relative")), "got int"),
        (lambda d, _: ims.Frame(d, ims.ObjectDepths([1.0], kind="relative"), camera=5), "Camera"),
        (lambda _, m: m.to_metric(ims.DepthMap([[1.0]], kind="relative"), 500.0), "a Camera"),
        (lambda *_: ims.DepthMap.from_ray_distance([[1.0]], 500.0), "a Camera"),
        (lambda *_: ims.Detection("a", (0, 0, 1, 1), track_id=[1]), "track_id"),
    ],
)  # fmt: skip
def test_swapped_and_bare_arguments_are_refused_by_name(call, message):
    detections = [box("pole", 20.0, top=0.0)]
    model = ims.fit(detections, ims.ObjectDepths([1.0], kind="relative"), POLE)
    with pytest.raises(TypeError, match=message):
        call(detections, model)


def test_a_generator_of_detections_is_taken_like_a_list():
    depth = ims.ObjectDepths([4.0], kind="relative")
    from_list = ims.fit([box("pole", 200.0)], depth, POLE)
    assert ims.fit((box("pole", 200.0) for _ in range(1)), depth, POLE) == from_list


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda record: record.pop("references"), "others: references"),
        (lambda record: record.update(extra=1), "others: extra"),
        (lambda record: record.update(schema=1), "schema 4; got 1"),
    ],
    ids=["missing", "extra", "schema"],
)
def test_a_record_that_to_dict_did_not_write_is_refused(change, message):
    model = ims.fit([box("pole", 200.0)], ims.ObjectDepths([4.0], kind="relative"), POLE)
    record = model.to_dict()
    change(record)
    with pytest.raises(ValueError, match=message):
        ims.ScaleModel.from_dict(record)


def test_a_table_in_another_encoding_or_with_a_column_twice_is_refused(tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes("label,mean_m,std_m\nTür,2.0,0.1\n".encode("latin-1"))
    with pytest.raises(ValueError, match="must be UTF-8; got byte 0xfc"):
        ims.PriorTable.from_csv(path)
    path.write_text("label,mean_m,std_m,std_m\ndoor,2.0,0.1,0.2\n", encoding="utf-8")
    with pytest.raises(ValueError, match="each column once"):
        ims.PriorTable.from_csv(path)


# --- what a single changed line once left unnoticed ---


@pytest.mark.parametrize(("first", "second"), [(0.15, 0.0), (0.0, 0.15), (0.1, 0.2)])
def test_two_metric_maps_bring_both_their_scale_errors(first, second):
    def metric(value, scale_rel_std):
        return ims.DepthMap(np.full((300, 400), value), kind="metric", scale_rel_std=scale_rel_std)

    pole, thing = box("pole", 200.0), box("thing", 100.0, left=200.0)
    noise = ims.Noise(depth_rel=0.05)
    model = ims.fit([pole], metric(6.0, first), POLE, method="robust", noise=noise)
    [same] = ims.predict(model, [thing], metric(6.0, first))
    [other] = ims.predict(model, [thing], metric(7.0, second))
    added = (other.std_m / other.size_m) ** 2 - (same.std_m / same.size_m) ** 2
    assert added == pytest.approx(first**2 + second**2, rel=1e-9)


def test_another_metric_map_gives_its_own_distances():
    network = ims.DepthMap(np.full((300, 400), 4.8), kind="metric", scale_rel_std=0.15)
    lidar = ims.DepthMap(np.full((300, 400), 6.0), kind="metric")
    camera = ims.Camera(600.0, focal_rel_std=0.0)
    model = ims.fit([box("pole", 200.0)], network, POLE, camera=camera)
    assert ims.predict(model, [box("pole", 200.0)], lidar)[0].distance_m == 6.0


@pytest.mark.parametrize(
    ("focal_px", "implausible"),
    [(250.0, True), (350.0, False), (100_000.0, False), (130_000.0, True)],
)
def test_without_image_size_the_boxes_and_the_largest_photos_bound_the_focal_length(
    focal_px, implausible
):
    # boxes reach to 1000 px, so the image is at least that wide, and 20 000 px at most
    pole = box("pole", 400.0, left=960.0)
    depth = ims.ObjectDepths([2.0 * focal_px / 400], kind="metric")
    model = ims.fit([pole], depth, POLE)
    assert (Flag.IMPLAUSIBLE_FOCAL in model.flags) == implausible


@pytest.mark.parametrize(("sigmas", "conflicts"), [(2.8, False), (3.2, True)])
@pytest.mark.parametrize("method", ["robust", "least_squares", "posterior"])
def test_a_camera_conflicts_beyond_three_standard_errors(sigmas, conflicts, method):
    exact = ims.PriorTable([ims.ObjectPrior("pole", 2.0, 0.0)])
    depth = ims.ObjectDepths([10.0], kind="metric", rel_std=0.03)
    camera = ims.Camera(1000 * math.exp(sigmas * 0.05), focal_rel_std=0.04)
    noise = ims.Noise(box_px=0.0)
    model = ims.fit([box("pole", 200.0)], depth, exact, camera=camera, method=method, noise=noise)
    assert (Flag.CAMERA_CONFLICT in model.flags) == conflicts


@pytest.mark.parametrize(
    ("apart", "widened", "inconsistent"),
    [(2.6, False, False), (3.0, True, False), (3.6, True, True)],
)
def test_two_references_widen_the_result_before_they_are_reported(apart, widened, inconsistent):
    # the median absolute deviation of two is half their distance, times 1.4826
    y, std = np.array([0.0, apart * 0.1]), 0.1
    obs = LogObservations(
        y=y, variance=np.full(2, std**2), tau=np.zeros(2), image=np.zeros(2, dtype=np.intp),
        group=np.arange(2), firm=np.zeros(2, dtype=np.bool_),
    )  # fmt: skip
    fitted = fit_robust(obs)
    assert (fitted.log_std[0] > std / math.sqrt(2) * (1 + 1e-9)) == widened
    assert bool(disagree(obs)[0]) == inconsistent


@pytest.mark.parametrize("method", ["robust", "posterior"])
def test_the_size_of_a_rejected_reference_is_its_measurement_with_all_its_noise(method):
    tall = 3.0
    heights = [200.0, 201.0, 199.0, 200.0 * tall]
    detections = [box("pole", p, left=10.0 + 50 * i) for i, p in enumerate(heights)]
    depth = ims.ObjectDepths([10.0] * 4, kind="relative", rel_std=0.05)
    model = ims.fit(detections, depth, POLE, method=method)
    outlier = model.references[-1]
    assert outlier.reason == "outlier"
    assert outlier.posterior_m == pytest.approx(model.k * 10 * 600, rel=1e-12)
    predicted = ims.predict(model, detections, depth, use_prior=True)[-1]
    assert outlier.posterior_m == pytest.approx(predicted.size_m, rel=1e-12)
    if method == "robust":
        variance = (model.k_std / model.k) ** 2 + 0.05**2 + (1 / 600) ** 2
        assert outlier.posterior_std_m / outlier.posterior_m == pytest.approx(math.sqrt(variance))


def test_the_axis_of_smaller_error_counts_the_error_of_the_mean():
    table = ims.PriorTable(
        [
            ims.ObjectPrior("board", 1.0, 0.02, mean_std_m=0.2),
            ims.ObjectPrior("board", 1.0, 0.1, axis="width"),
        ]
    )
    board = box("board", 100.0, width=100.0)
    model = ims.fit([board], ims.ObjectDepths([4.0], kind="relative"), table)
    assert model.references[0].axis == "width"


def test_a_mixture_has_the_moments_of_its_parts():
    table = ims.PriorTable(
        [
            ims.ObjectPrior("folk", 1.7, 0.1, mean_std_m=0.02, share=0.75),
            ims.ObjectPrior("folk", 1.1, 0.2, mean_std_m=0.06, share=0.25),
        ]
    )
    model = ims.fit([box("folk", 100.0)], ims.ObjectDepths([4.0], kind="relative"), table)
    ref = model.references[0]
    mean = 0.75 * 1.7 + 0.25 * 1.1
    second = 0.75 * (1.7**2 + 0.1**2) + 0.25 * (1.1**2 + 0.2**2)
    assert ref.prior_m == pytest.approx(mean)
    assert ref.prior_std_m == pytest.approx(math.sqrt(second - mean**2))
    assert ref.prior_mean_std_m == pytest.approx(0.75 * 0.02 + 0.25 * 0.06)


def test_a_picture_of_floats_is_not_clipped():
    with pytest.raises(ValueError, match='got mode "F"'):
        ims.measure(Image.new("F", (30, 20)), detector=lambda _: [], depth_source=lambda _: None)


def test_the_camera_tells_the_size_of_the_image_where_the_depth_does_not():
    camera = ims.Camera(600.0, focal_rel_std=0.01, image_size=(640, 480))
    depth = ims.ObjectDepths([5.0, 5.0], kind="metric")
    cut, whole = box("pole", 460.0), box("pole", 240.0, left=200.0)
    model = ims.fit([cut, whole], depth, POLE, camera=camera)
    assert [ref.reason for ref in model.references] == ["partial", ""]
    assert Flag.PARTIAL in ims.predict(model, [cut, whole], depth)[0].flags
    with pytest.raises(ValueError, match="must lie in the image, 640 x 480 px"):
        ims.fit([cut, box("pole", 700.0)], depth, POLE, camera=camera)


def test_a_telephoto_is_no_reservation_where_depth_is_not_metric():
    camera = ims.Camera(9000.0, focal_rel_std=0.01, image_size=(640, 480))
    model = ims.fit(
        [box("pole", 240.0)], ims.ObjectDepths([5.0], kind="relative"), POLE, camera=camera
    )
    assert model.flags == Flag.SINGLE_REFERENCE


# --- inputs of another picture, another unit, another corner ---


WIDE = (640, 480)
FLAT = ims.DepthMap([[4.0]], kind="relative", image_size=WIDE)


def test_ratios_given_as_pixels_are_refused_with_the_remedy():
    doors = [ims.Detection("door", (0.1, 0.2, 0.3, 0.8)), ims.Detection("door", (0.5, 0, 0.6, 1))]
    for depth in (FLAT, ims.ObjectDepths([4.0, 4.0], kind="relative")):
        with pytest.raises(ValueError, match=r"must be in pixels; got .*Detection.from_ratios"):
            ims.fit(doors, depth)


def test_boxes_of_a_picture_that_was_turned_are_named_as_such():
    doors = [ims.Detection("door", (10, 500, 100, 630)), ims.Detection("door", (9, 0, 60, 90))]
    with pytest.raises(ValueError, match="fit the image turned by 90 degrees: apply its EXIF"):
        ims.fit(doors, FLAT)


def test_corners_given_as_width_and_height_are_named_as_such():
    doors = [
        ims.Detection.from_xywh("door", (300, 200, 420, 460)),
        ims.Detection.from_xywh("door", (10, 20, 100, 220)),
    ]
    with pytest.raises(ValueError, match=r"corners go through Detection\(\), not"):
        ims.fit(doors, FLAT)


def test_boxes_of_a_larger_picture_name_the_image_size_as_the_remedy():
    with pytest.raises(ValueError, match=r"a larger image \(1900 x 800 or more\).*image_size"):
        ims.fit([ims.Detection("door", (1500, 700, 1900, 800))], FLAT)


@pytest.mark.parametrize("shape", [(640, 480), (320, 240), (513, 380)])
def test_a_map_that_lies_on_its_side_is_refused(shape):
    with pytest.raises(ValueError, match=r"map's|lies on its side"):
        ims.DepthMap(np.ones(shape), kind="relative", image_size=WIDE)


@pytest.mark.parametrize("shape", [(518, 518), (240, 320), (1, 1), (384, 672), (600, 480)])
def test_a_map_that_a_network_stretched_is_accepted(shape):
    assert ims.DepthMap(np.ones(shape), kind="relative", image_size=WIDE).image_size == WIDE
