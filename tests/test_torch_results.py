"""Results of ultralytics and torchvision, read from stand-ins made of arrays and of tensors."""

from types import SimpleNamespace

import numpy as np
import pytest

import imgscale as ims
from imgscale.detectors.torchvision import from_torchvision
from imgscale.detectors.ultralytics import UltralyticsDetector, from_ultralytics

NAMES = {0: "person", 2: "car", 7: "truck"}
CATEGORIES = ("__background__", "person", "bicycle", "car", "N/A")


@pytest.fixture(params=["numpy", "torch"])
def array(request):
    """Make arrays of one of the two libraries."""
    if request.param == "numpy":
        return np.asarray
    return pytest.importorskip("torch", reason="needs PyTorch").tensor


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="needs PyTorch")


def all_types(torch):
    return (torch.float64, torch.float32, torch.float16, torch.bfloat16)


# --- ultralytics: the attributes of its Results, Boxes and Masks ---


class Boxes:
    """Columns x1, y1, x2, y2, [track,] score, class, as the real one keeps them."""

    def __init__(self, data):
        self.data = data
        self.xyxy, self.conf, self.cls = data[:, :4], data[:, -2], data[:, -1]
        self.id = data[:, -3] if data.shape[1] == 7 else None


class Results:
    def __init__(self, shape, boxes=None, masks=None, obb=None, probs=None):
        self.orig_shape, self.names = shape, NAMES
        self.boxes = None if boxes is None else Boxes(boxes)
        self.masks = None if masks is None else SimpleNamespace(data=masks)
        self.obb, self.probs, self.keypoints = obb, probs, None

    def __getitem__(self, index):
        boxes = None if self.boxes is None else self.boxes.data[index]
        masks = None if self.masks is None else self.masks.data[index]
        return Results(self.orig_shape, boxes, masks)


CAR_AND_PERSON = [[10.5, 20.25, 110.5, 70.75, 0.75, 2.0], [300.0, 40.0, 340.0, 150.0, 0.5, 0.0]]


def letterboxed(mask, side):
    """Put a mask into a square input as LetterBox does: resize, then bars, the first narrower."""
    from PIL import Image  # noqa: PLC0415 - one test's independent route

    height, width = mask.shape
    gain = min(side / height, side / width)
    size = (round(width * gain), round(height * gain))
    small = np.asarray(Image.fromarray(mask).resize(size, Image.Resampling.NEAREST))
    bars = [(side - length) / 2 for length in small.shape]
    return np.pad(small, [(round(bar - 0.1), round(bar + 0.1)) for bar in bars])


def ellipse(shape):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return ((x / shape[1] - 0.4) / 0.3) ** 2 + ((y / shape[0] - 0.6) / 0.2) ** 2 < 1


def test_boxes_keep_order_fractions_scores_and_the_names_of_float_classes(array):
    car, person = from_ultralytics(Results((480, 640), array(CAR_AND_PERSON)))
    assert (car.label, car.xyxy, car.score) == ("car", (10.5, 20.25, 110.5, 70.75), 0.75)
    assert (person.label, person.xyxy, person.score) == ("person", (300, 40, 340, 150), 0.5)
    assert car.mask is None
    assert car.track_id is None


def test_tracks_number_the_objects_with_whole_numbers(array):
    tracked = [[10, 20, 110, 70, 41.0, 0.75, 2.0]]
    (car,) = from_ultralytics(Results((480, 640), array(tracked)))
    assert car.track_id == 41
    assert isinstance(car.track_id, int)


def test_a_picture_without_objects_gives_no_detections(array):
    assert from_ultralytics(Results((480, 640), array(np.zeros((0, 6))))) == []


def test_results_in_every_float_type_and_with_gradients_are_read(torch):
    for dtype in all_types(torch):
        boxes = torch.tensor([[10.5, 20.25, 110.5, 70.5, 0.75, 2.0]], dtype=dtype)
        masks = torch.zeros((1, 480, 640), dtype=dtype)
        masks[0, 30:60, 20:100] = 1
        (car,) = from_ultralytics(Results((480, 640), boxes.requires_grad_(), masks))
        assert car.xyxy == (10.5, 20.25, 110.5, 70.5)
        assert car.mask.sum() == 30 * 80


@pytest.mark.parametrize(
    ("shape", "side"),
    [
        pytest.param((480, 640), 640, id="bars above and below"),
        pytest.param((640, 480), 640, id="bars left and right"),
        pytest.param((427, 640), 640, id="bars of unequal height"),
        pytest.param((100, 60), 400, id="enlarged four times"),
        pytest.param((640, 640), 640, id="no bars"),
    ],
)
def test_masks_leave_the_letterbox_exactly_where_no_pixel_was_lost(array, shape, side):
    mask = ellipse(shape)
    data = array(letterboxed(mask, side)[np.newaxis].astype(np.uint8))
    box = [[0, 0, shape[1], shape[0], 0.9, 2.0]]
    (found,) = from_ultralytics(Results(shape, array(box), data))
    assert found.mask.shape == shape
    assert np.array_equal(found.mask, mask)


@pytest.mark.parametrize("shape", [(1080, 1920), (1333, 2000), (3000, 1999)])
def test_masks_of_a_reduced_picture_err_by_less_than_a_pixel_of_the_network(shape):
    mask = ellipse(shape)
    box = [[0, 0, shape[1], shape[0], 0.9, 2.0]]
    data = letterboxed(mask, 640)[np.newaxis]
    (found,) = from_ultralytics(Results(shape, np.array(box), data))
    for axis in (0, 1):
        extents = [np.flatnonzero(m.any(axis=axis))[[0, -1]] for m in (mask, found.mask)]
        assert np.abs(extents[0] - extents[1]).max() < max(shape) / 640


def test_masks_at_the_pictures_own_size_are_taken_as_they_are(array):
    data = np.zeros((2, 480, 640), dtype=np.float32)
    data[0, 25:60, 20:100] = 1
    data[1, 50:140, 310:330] = 1
    car, person = from_ultralytics(Results((480, 640), array(CAR_AND_PERSON), array(data)))
    assert np.array_equal(car.mask, data[0] > 0)
    assert np.array_equal(person.mask, data[1] > 0)


def test_an_empty_mask_leaves_the_box_alone(array):
    data = np.zeros((2, 480, 640), dtype=np.uint8)
    data[0, 25:60, 20:100] = 1
    car, person = from_ultralytics(Results((480, 640), array(CAR_AND_PERSON), array(data)))
    assert car.mask is not None
    assert person.mask is None


def test_results_are_not_written_to():
    boxes, masks = np.array(CAR_AND_PERSON), np.ones((2, 480, 640), dtype=np.uint8)
    before = boxes.copy(), masks.copy()
    from_ultralytics(Results((480, 640), boxes, masks))
    assert np.array_equal(boxes, before[0])
    assert np.array_equal(masks, before[1])


@pytest.mark.parametrize(
    ("result", "error", "message"),
    [
        pytest.param([Results((480, 640))], TypeError, r"Pass result\[0\]", id="list"),
        pytest.param(Results((480, 640), obb=object()), ValueError, "oriented ones", id="oriented"),
        pytest.param(
            Results((480, 640), probs=object()), ValueError, "must have boxes", id="class"
        ),
        pytest.param({"boxes": 1}, TypeError, "ultralytics Results; got dict", id="dict"),
    ],
)
def test_results_without_upright_boxes_of_one_picture_are_refused(result, error, message):
    with pytest.raises(error, match=message):
        from_ultralytics(result)


def test_a_class_without_a_name_is_refused_with_its_place():
    rows = [CAR_AND_PERSON[0], [0, 0, 5, 5, 0.5, 3.0]]
    with pytest.raises(ValueError, match=r"result\[1\]: `names` must have class 3"):
        from_ultralytics(Results((480, 640), np.array(rows)))


def test_a_box_outside_the_picture_is_refused_with_its_place():
    rows = [CAR_AND_PERSON[0], [700, 0, 720, 5, 0.5, 2.0]]
    with pytest.raises(ValueError, match=r"result\[1\]: the box must overlap"):
        from_ultralytics(Results((480, 640), np.array(rows)))


class Yolo:
    """What a model does with an array: it takes the channels for blue, green, red."""

    def __init__(self, boxes):
        self.boxes, self.seen = boxes, None

    def __call__(self, source, *, conf, verbose):
        self.seen = (source, conf, verbose)
        return [Results(source.shape[:2], self.boxes)]


def test_the_runner_hands_the_model_blue_first_and_its_threshold():
    image = np.zeros((48, 64, 3), dtype=np.uint8)
    image[...] = (200, 100, 50)
    model = Yolo(np.array([[1.5, 2, 30, 40, 0.75, 2.0]]))
    (car,) = UltralyticsDetector(model, threshold=0.3)(image)
    source, conf, verbose = model.seen
    assert source[0, 0].tolist() == [50, 100, 200]
    assert source.flags.c_contiguous
    assert (conf, verbose) == (0.3, False)
    assert car.xyxy == (1.5, 2, 30, 40)


def test_the_runner_drops_boxes_outside_the_picture_and_cuts_the_others(array):
    rows = [[-9, 2, 30, 60, 0.75, 2.0], [64, 2, 64, 40, 0.7, 2.0], [5, -9, 9, -1, 0.6, 0.0]]
    image = np.zeros((48, 64, 3), dtype=np.uint8)
    found = UltralyticsDetector(Yolo(array(rows)), threshold=0.3)(image)
    assert [detection.xyxy for detection in found] == [(0, 2, 30, 48)]


def test_the_runner_serves_measure():
    boxes = np.array([[100, 200, 180, 310, 0.9, 0.0], [300, 180, 500, 260, 0.9, 2.0]])
    result = ims.measure(
        np.zeros((480, 640, 3), dtype=np.uint8),
        detector=UltralyticsDetector(Yolo(boxes), threshold=0.5),
        depth_source=lambda image: ims.DepthMap(np.full(image.shape[:2], 9.0), kind="relative"),
    )
    assert [estimate.label for estimate in result.estimates] == ["person", "car"]


@pytest.mark.parametrize("threshold", [50, -0.1, float("nan"), "0.5"])
def test_a_threshold_that_is_no_ratio_is_refused(threshold):
    with pytest.raises((ValueError, TypeError), match="`threshold` must be between 0 and 1"):
        UltralyticsDetector(Yolo(None), threshold=threshold)


# --- torchvision: a dict per picture ---


def output_of(array, **changes):
    output = {
        "boxes": array([[10.5, 20.25, 110.5, 70.75], [300.0, 40.0, 340.0, 150.0]]),
        "labels": array([3, 1]),
        "scores": array([0.75, 0.5]),
    }
    return output | changes


def test_label_numbers_count_from_the_background(array):
    car, person = from_torchvision(output_of(array), categories=CATEGORIES)
    assert (car.label, car.xyxy, car.score) == ("car", (10.5, 20.25, 110.5, 70.75), 0.75)
    assert (person.label, person.xyxy, person.score) == ("person", (300, 40, 340, 150), 0.5)
    assert car.mask is None


def test_categories_without_the_background_would_shift_every_name_and_are_refused(array):
    with pytest.raises(ValueError, match=r"got \['person', 'bicycle'\]"):
        from_torchvision(output_of(array), categories=["person", "bicycle", "car", "bus"])


def test_holes_of_the_category_list_are_kept_as_they_come(array):
    output = output_of(array, labels=array([4, 0]))
    labels = [found.label for found in from_torchvision(output, categories=CATEGORIES)]
    assert labels == ["N/A", "__background__"]


def test_masks_are_cut_at_the_users_threshold(array):
    masks = np.zeros((2, 1, 480, 640), dtype=np.float32)
    masks[0, 0, 30:60, 20:100] = 0.5
    masks[0, 0, 30:60, 100:105] = 0.25
    output = output_of(array, masks=array(masks))
    car, person = from_torchvision(output, categories=CATEGORIES, mask_threshold=0.5)
    assert np.array_equal(car.mask, masks[0, 0] >= 0.5)
    assert person.mask is None
    car, _ = from_torchvision(output, categories=CATEGORIES, mask_threshold=0.2)
    assert car.mask.sum() == 30 * 85


@pytest.mark.parametrize("threshold", [None, 0, 0.0, 50, "0.5"])
def test_masks_without_a_lawful_threshold_are_refused(threshold):
    output = output_of(np.asarray, masks=np.ones((2, 1, 480, 640), dtype=np.float32))
    with pytest.raises((ValueError, TypeError), match="`mask_threshold` must be above 0"):
        from_torchvision(output, categories=CATEGORIES, mask_threshold=threshold)


def test_masks_of_another_shape_are_refused():
    output = output_of(np.asarray, masks=np.ones((2, 480, 640), dtype=np.float32))
    with pytest.raises(ValueError, match=r"must have shape \(2, 1, H, W\)"):
        from_torchvision(output, categories=CATEGORIES, mask_threshold=0.5)


def test_outputs_in_every_float_type_and_with_gradients_are_read(torch):
    for dtype in all_types(torch):
        output = {
            "boxes": torch.tensor([[10.5, 20.25, 110.5, 70.5]], dtype=dtype, requires_grad=True),
            "labels": torch.tensor([1]),
            "scores": torch.tensor([0.75], dtype=dtype, requires_grad=True),
            "masks": torch.full((1, 1, 480, 640), 0.75, dtype=dtype, requires_grad=True),
        }
        (person,) = from_torchvision(output, categories=CATEGORIES, mask_threshold=0.5)
        assert person.xyxy == (10.5, 20.25, 110.5, 70.5)
        assert person.score == 0.75
        assert person.mask.all()


def test_an_output_without_objects_gives_no_detections(array):
    empty = {
        "boxes": array(np.zeros((0, 4), dtype=np.float32)),
        "labels": array(np.zeros(0, dtype=np.int64)),
        "scores": array(np.zeros(0, dtype=np.float32)),
        "masks": array(np.zeros((0, 1, 480, 640), dtype=np.float32)),
    }
    assert from_torchvision(empty, categories=CATEGORIES, mask_threshold=0.5) == []


def test_boxes_are_cut_at_the_border_where_the_size_is_known(array):
    output = output_of(array, boxes=array([[-3.0, 20.0, 110.0, 70.0], [300.0, 40.0, 650.0, 150.0]]))
    cut = from_torchvision(output, categories=CATEGORIES, image_size=(640, 480))
    assert [found.xyxy for found in cut] == [(0, 20, 110, 70), (300, 40, 640, 150)]


def test_outputs_are_not_written_to():
    output = output_of(np.asarray, masks=np.full((2, 1, 480, 640), 0.7))
    before = {key: value.copy() for key, value in output.items()}
    from_torchvision(output, categories=CATEGORIES, mask_threshold=0.5, image_size=(640, 480))
    assert all(np.array_equal(output[key], before[key]) for key in before)


@pytest.mark.parametrize(
    ("output", "error", "message"),
    [
        pytest.param([{}], TypeError, r"got list\. Pass output\[0\]", id="list"),
        pytest.param(None, TypeError, "got NoneType", id="nothing"),
        pytest.param({"loss_classifier": 0.5}, ValueError, r"call model\.eval\(\)", id="losses"),
        pytest.param(
            output_of(np.asarray, scores=np.array([0.5])), ValueError, "1 scores", id="lengths"
        ),
        pytest.param(
            output_of(np.asarray, labels=np.array([1, 91])),
            ValueError,
            r"output\[1\]: `categories` must name label 91; got 5",
            id="label without a name",
        ),
        pytest.param(
            output_of(np.asarray, scores=np.array([0.5, 50.0])),
            ValueError,
            r"output\[1\]: `score` must be between 0 and 1",
            id="percent",
        ),
    ],
)
def test_outputs_that_are_not_one_pictures_detections_are_refused(output, error, message):
    with pytest.raises(error, match=message):
        from_torchvision(output, categories=CATEGORIES)
