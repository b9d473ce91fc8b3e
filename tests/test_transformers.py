"""Detectors and depth networks of transformers: tiny random models, run for real and offline."""

import importlib.util
import os
from types import SimpleNamespace

import numpy as np
import pytest

import imgscale as ims
from imgscale import _optional
from imgscale.depth_sources.transformers import TransformersDepth, kind_of
from imgscale.depth_sources.transformers import from_transformers as depth_from
from imgscale.detectors.transformers import TransformersDetector
from imgscale.detectors.transformers import from_transformers as detections_from

os.environ.setdefault("HF_HUB_OFFLINE", "1")  # before transformers is imported

NAMES = {0: "person", 1: "car"}
BOX = {"xmin": 159, "ymin": 120, "xmax": 479, "ymax": 359}
CAR = {"score": 0.75, "label": "car", "box": BOX}
POST_PROCESSED = {
    "boxes": np.array([[10.5, 20.25, 110.5, 70.75], [300.0, 40.0, 340.0, 150.0]]),
    "scores": np.array([0.75, 0.5]),
    "labels": np.array([1, 0]),
}


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch", reason="needs PyTorch")


@pytest.fixture(scope="module")
def tf(torch):
    del torch  # absent torch leaves transformers without models
    return pytest.importorskip("transformers", reason="needs transformers")


# --- tiny models, saved and loaded as checkpoints are ---


def yolos(tf):
    config = tf.YolosConfig(
        hidden_size=32,
        num_hidden_layers=2,
        num_attention_heads=2,
        intermediate_size=64,
        image_size=[64, 96],
        num_detection_tokens=10,
        id2label=NAMES,
    )
    processor = tf.YolosImageProcessor(size={"height": 64, "width": 96})
    return tf.YolosForObjectDetection(config), processor


def detr(tf):
    backbone = tf.ResNetConfig(
        embedding_size=16,
        hidden_sizes=[16, 16, 32, 32],
        depths=[1, 1, 1, 1],
        layer_type="basic",
        out_features=["stage4"],
    )
    config = tf.DetrConfig(
        use_timm_backbone=False,
        use_pretrained_backbone=False,
        backbone=None,
        backbone_config=backbone,
        d_model=32,
        encoder_layers=1,
        decoder_layers=1,
        encoder_attention_heads=2,
        decoder_attention_heads=2,
        encoder_ffn_dim=64,
        decoder_ffn_dim=64,
        num_queries=10,
        id2label=NAMES,
    )
    processor = tf.DetrImageProcessor(size={"shortest_edge": 64, "longest_edge": 128})
    return tf.DetrForObjectDetection(config), processor


def rt_detr(tf):
    backbone = tf.RTDetrResNetConfig(
        embedding_size=16,
        hidden_sizes=[16, 32, 32, 32],
        depths=[1, 1, 1, 1],
        layer_type="basic",
        out_features=["stage2", "stage3", "stage4"],
    )
    config = tf.RTDetrConfig(
        backbone_config=backbone,
        encoder_in_channels=[32, 32, 32],
        encoder_hidden_dim=32,
        d_model=32,
        encoder_layers=1,
        encoder_ffn_dim=64,
        encoder_attention_heads=2,
        decoder_in_channels=[32, 32, 32],
        decoder_layers=1,
        decoder_ffn_dim=64,
        decoder_attention_heads=2,
        num_queries=10,
        num_denoising=0,
        id2label=NAMES,
    )
    processor = tf.RTDetrImageProcessor(size={"height": 64, "width": 96})
    return tf.RTDetrForObjectDetection(config), processor


def depth_anything(tf, **options):
    backbone = tf.Dinov2Config(
        hidden_size=32,
        num_hidden_layers=4,
        num_attention_heads=2,
        mlp_ratio=2,
        image_size=70,
        patch_size=14,
        out_features=["stage1", "stage2", "stage3", "stage4"],
        apply_layernorm=True,
        reshape_hidden_states=False,
    )
    config = tf.DepthAnythingConfig(
        backbone_config=backbone,
        reassemble_hidden_size=32,
        neck_hidden_sizes=[8, 16, 32, 32],
        fusion_hidden_size=16,
        head_hidden_size=8,
        patch_size=14,
        **options,
    )
    processor = tf.DPTImageProcessor(
        size={"height": 70, "width": 70}, keep_aspect_ratio=True, ensure_multiple_of=14
    )
    return tf.DepthAnythingForDepthEstimation(config), processor


def depth_anything_metric(tf):
    return depth_anything(tf, depth_estimation_type="metric", max_depth=20)


def dpt(tf):
    config = tf.DPTConfig(
        hidden_size=32,
        num_hidden_layers=4,
        num_attention_heads=2,
        intermediate_size=64,
        image_size=64,
        patch_size=16,
        is_hybrid=False,
        backbone_out_indices=[0, 1, 2, 3],
        neck_hidden_sizes=[8, 16, 32, 32],
        fusion_hidden_size=16,
    )
    return tf.DPTForDepthEstimation(config), tf.DPTImageProcessor(size={"height": 64, "width": 64})


def glpn(tf):
    config = tf.GLPNConfig(
        hidden_sizes=[8, 16, 32, 32],
        num_attention_heads=[1, 1, 2, 2],
        depths=[1, 1, 1, 1],
        decoder_hidden_size=16,
        max_depth=10,
    )
    return tf.GLPNForDepthEstimation(config), tf.GLPNImageProcessor()


def zoedepth(tf):
    backbone = tf.BeitConfig(
        hidden_size=32,
        num_hidden_layers=4,
        num_attention_heads=2,
        intermediate_size=64,
        image_size=64,
        patch_size=16,
        out_features=["stage1", "stage2", "stage3", "stage4"],
        reshape_hidden_states=False,
    )
    config = tf.ZoeDepthConfig(
        backbone_config=backbone,
        neck_hidden_sizes=[8, 16, 32, 32],
        fusion_hidden_size=16,
        bottleneck_features=16,
        bin_embedding_dim=8,
        num_attractors=[4, 2, 1, 1],
        bin_configurations=[{"n_bins": 8, "min_depth": 0.001, "max_depth": 10.0, "name": "nyu"}],
        backbone_hidden_size=32,
    )
    processor = tf.ZoeDepthImageProcessor(size={"height": 64, "width": 64}, ensure_multiple_of=16)
    return tf.ZoeDepthForDepthEstimation(config), processor


def depth_pro(tf):
    vit = {
        "model_type": "dinov2",
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "hidden_size": 16,
        "patch_size": 8,
        "mlp_ratio": 2,
        "image_size": 32,
    }
    config = tf.DepthProConfig(
        patch_size=32,
        fusion_hidden_size=16,
        intermediate_hook_ids=[1, 0],
        intermediate_feature_dims=[8, 8],
        scaled_images_ratios=[0.25, 0.5, 1],
        scaled_images_overlap_ratios=[0.0, 0.5, 0.25],
        scaled_images_feature_dims=[16, 16, 16],
        use_batch_norm_in_fusion_residual=False,
        image_model_config=dict(vit),
        patch_model_config=dict(vit),
        fov_model_config=dict(vit),
        use_fov_model=True,
    )
    return tf.DepthProForDepthEstimation(config), DepthProStandIn()


class DepthProStandIn:
    """
    In the place of its image processor, which cannot be made without torchvision.

    The arithmetic of post-processing, without its resizing to the picture.
    """

    def __call__(self, images, *, return_tensors, input_data_format):
        import torch  # noqa: PLC0415 - where it is absent this never runs
        from transformers import BatchFeature  # noqa: PLC0415

        assert (return_tensors, input_data_format) == ("pt", "channels_last")
        pixels = torch.from_numpy(images).permute(2, 0, 1)[None] / 127.5 - 1
        return BatchFeature({"pixel_values": pixels})

    def post_process_depth_estimation(self, outputs, target_sizes):
        (canonical,), (fov,), ((_, width),) = (
            outputs.predicted_depth,
            outputs.field_of_view,
            target_sizes,
        )
        focal = 0.5 * width / (0.5 * fov.deg2rad()).tan()
        depth = 1 / (canonical * width / focal).clamp(1e-4, 1e4)
        return [{"predicted_depth": depth, "field_of_view": fov, "focal_length": focal}]


@pytest.fixture(scope="module")
def checkpoint(tf, torch, tmp_path_factory):
    """Save a tiny model once and give its folder."""
    folders = {}

    def save(make):
        if make not in folders:
            torch.manual_seed(0)
            folders[make] = tmp_path_factory.mktemp(make.__name__)
            for part in make(tf):
                part.save_pretrained(folders[make])
        return folders[make]

    return save


@pytest.fixture(scope="module")
def pipe_of(tf, checkpoint):
    def load(task, make):
        return tf.pipeline(task, model=str(checkpoint(make)))

    return load


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(7).integers(0, 256, (120, 200, 3), dtype=np.uint8)


def pil(picture):
    from PIL import Image  # noqa: PLC0415 - beside its use

    return Image.fromarray(picture)


# --- detections of what is already there ---


def test_a_pipelines_list_keeps_order_labels_and_scores():
    person = {"score": 0.5, "label": "person", "box": BOX | {"xmin": 10}}
    found = detections_from([CAR, person])
    assert [detection.label for detection in found] == ["car", "person"]
    assert [detection.score for detection in found] == [0.75, 0.5]
    assert found[0].xyxy == (159, 120, 479, 359)


def test_a_post_processed_dict_keeps_the_fractions_and_takes_names_from_the_model():
    car, person = detections_from(POST_PROCESSED, id2label=NAMES)
    assert (car.label, car.xyxy, car.score) == ("car", (10.5, 20.25, 110.5, 70.75), 0.75)
    assert (person.label, person.xyxy) == ("person", (300, 40, 340, 150))


def test_a_zero_shot_dict_brings_its_own_names():
    zero_shot = POST_PROCESSED | {"text_labels": ["red car", "a person"]}
    assert [found.label for found in detections_from(zero_shot)] == ["red car", "a person"]


def test_nothing_detected_gives_no_detections():
    empty = {"boxes": np.zeros((0, 4)), "scores": np.zeros(0), "labels": np.zeros(0)}
    assert detections_from([]) == []
    assert detections_from(empty, id2label=NAMES) == []


def test_boxes_are_cut_at_the_border_where_the_size_is_known():
    (car,) = detections_from([CAR | {"box": BOX | {"xmin": -8}}], image_size=(400, 300))
    assert car.xyxy == (0, 120, 400, 300)


def test_tensors_of_every_float_type_and_with_gradients_are_read(torch):
    for dtype in (torch.float64, torch.float32, torch.float16, torch.bfloat16):
        tensors = {
            "boxes": torch.tensor([[10.5, 20.25, 110.5, 70.5]], dtype=dtype, requires_grad=True),
            "scores": torch.tensor([0.75], dtype=dtype, requires_grad=True),
            "labels": torch.tensor([1]),
        }
        (car,) = detections_from(tensors, id2label=NAMES)
        assert (car.label, car.xyxy, car.score) == ("car", (10.5, 20.25, 110.5, 70.5), 0.75)


def test_results_are_not_written_to():
    entry = {"score": 0.75, "label": "car", "box": dict(BOX)}
    arrays = {key: value.copy() for key, value in POST_PROCESSED.items()}
    detections_from([entry], image_size=(400, 300))
    detections_from(arrays, id2label=NAMES, image_size=(320, 60))
    assert entry == CAR
    assert all(np.array_equal(arrays[key], POST_PROCESSED[key]) for key in arrays)


@pytest.mark.parametrize(
    ("results", "error", "message"),
    [
        pytest.param([[CAR], [CAR]], ValueError, r"Pass results\[0\] alone", id="list of lists"),
        pytest.param([POST_PROCESSED], ValueError, r"Pass results\[0\] alone", id="list of dicts"),
        pytest.param("car", TypeError, "got str", id="text"),
        pytest.param([CAR, {"label": "car"}], ValueError, r"results\[1\] must have", id="no box"),
        pytest.param([CAR, 3], ValueError, r"results\[1\] must have", id="number"),
        pytest.param(
            [CAR, CAR | {"box": [1, 2, 3, 4]}], ValueError, r"results\[1\] must have", id="corners"
        ),
        pytest.param(
            [CAR, CAR | {"score": 75.0}], ValueError, r"results\[1\]: `score` must", id="percent"
        ),
        pytest.param({"logits": 1}, ValueError, "post_process_object_detection", id="raw output"),
        pytest.param(
            POST_PROCESSED | {"scores": np.array([0.5])}, ValueError, "2 boxes, 1 scores", id="few"
        ),
        pytest.param(
            POST_PROCESSED | {"labels": np.array([1, 17])},
            ValueError,
            r"results\[1\]: `id2label` must name label 17",
            id="unknown label",
        ),
    ],
)
def test_results_that_are_not_one_pictures_detections_are_refused(results, error, message):
    with pytest.raises(error, match=message):
        detections_from(results, id2label=NAMES)


def test_a_text_is_no_column_of_names():
    with pytest.raises(ValueError, match='"text_labels" being str'):
        detections_from(POST_PROCESSED | {"text_labels": "ab"})


def test_numbers_without_names_are_refused():
    with pytest.raises(ValueError, match=r"Pass id2label=model\.config\.id2label"):
        detections_from(POST_PROCESSED)


def test_a_box_outside_the_picture_is_refused_with_its_place():
    with pytest.raises(ValueError, match=r"results\[1\]: the box must overlap"):
        detections_from([CAR, CAR | {"box": BOX | {"xmin": 420}}], image_size=(400, 400))


# --- the detector, run ---

DETECTORS = [yolos, detr, rt_detr]


@pytest.mark.parametrize("make", DETECTORS)
def test_the_runner_gives_the_pipelines_boxes_before_they_are_truncated(make, pipe_of, picture):
    pipe = pipe_of("object-detection", make)
    whole = detections_from(pipe(pil(picture), threshold=0.0), image_size=(200, 120))
    fine = TransformersDetector(pipe.model, pipe.image_processor, threshold=0.0)(picture)
    assert len(fine) == len(whole) > 0
    assert [(found.label, found.score) for found in fine] == [
        (found.label, found.score) for found in whole
    ]
    lost = np.subtract([found.xyxy for found in fine], [found.xyxy for found in whole])
    assert lost.min() >= 0
    assert lost.max() < 1
    assert lost.max() > 0.01


@pytest.mark.parametrize("make", DETECTORS)
def test_models_loaded_by_hand_detect_as_those_of_a_pipeline(
    make, tf, checkpoint, pipe_of, picture
):
    folder = checkpoint(make)
    by_hand = TransformersDetector(
        tf.AutoModelForObjectDetection.from_pretrained(folder),
        tf.AutoImageProcessor.from_pretrained(folder),
        threshold=0.2,
    )
    pipe = pipe_of("object-detection", make)
    of_pipe = TransformersDetector(pipe.model, pipe.image_processor, threshold=0.2)
    assert by_hand(picture) == of_pipe(picture)


@pytest.mark.parametrize("make", DETECTORS)
def test_the_threshold_is_the_users(make, pipe_of, picture):
    pipe = pipe_of("object-detection", make)
    everything = TransformersDetector(pipe.model, pipe.image_processor, threshold=0.0)(picture)
    middle = float(np.median([found.score for found in everything]))
    some = TransformersDetector(pipe.model, pipe.image_processor, threshold=middle)(picture)
    assert some == [found for found in everything if found.score > middle]
    assert TransformersDetector(pipe.model, pipe.image_processor, threshold=1.0)(picture) == []


@pytest.mark.parametrize("make", [yolos, detr])
def test_a_model_in_bfloat16_is_fed_in_bfloat16(make, tf, torch, checkpoint, picture):
    folder = checkpoint(make)
    model = tf.AutoModelForObjectDetection.from_pretrained(folder, dtype=torch.bfloat16)
    processor = tf.AutoImageProcessor.from_pretrained(folder)
    found = TransformersDetector(model, processor, threshold=0.0)(picture)
    assert model.dtype == torch.bfloat16
    assert all(0 <= d.xyxy[0] < d.xyxy[2] <= 200 for d in found)
    assert len(found) == 10


@pytest.mark.parametrize("size", [(3, 200), (200, 1), (1, 1)])
def test_pictures_of_a_few_pixels_are_not_taken_for_channels(size, pipe_of):
    pipe = pipe_of("object-detection", yolos)
    picture = np.full((*size, 3), 90, dtype=np.uint8)
    found = TransformersDetector(pipe.model, pipe.image_processor, threshold=0.0)(picture)
    assert len(found) == 10


class Drawing:
    """A model that says what it is told: real post-processing then makes boxes of it."""

    def __init__(self, tf, torch, centres_and_sizes):
        self.config = tf.YolosConfig(id2label=NAMES)
        self.device, self.dtype = torch.device("cpu"), torch.float32
        boxes = torch.tensor([centres_and_sizes])
        logits = torch.tensor([[[0.0, 5.0, 0.0]] * len(centres_and_sizes)])
        self.said = SimpleNamespace(logits=logits, pred_boxes=boxes)

    def __call__(self, pixel_values, **_):
        assert pixel_values.shape[1] == 3
        return self.said


def test_boxes_are_cut_at_the_border_and_dropped_beyond_it(tf, torch, picture):
    drawn = [
        [0.5, 0.5, 0.25, 0.5],
        [0.0, 0.5, 0.5, 0.5],
        [1.5, 0.5, 0.5, 0.5],
        [0.5, -0.5, 0.5, 0.5],
        [-0.5, 0.5, 1.0, 0.5],
    ]
    processor = tf.YolosImageProcessor(size={"height": 64, "width": 96})
    found = TransformersDetector(Drawing(tf, torch, drawn), processor, threshold=0.5)(picture)
    assert [detection.xyxy for detection in found] == [(75, 30, 125, 90), (0, 30, 50, 90)]
    assert [detection.label for detection in found] == ["car", "car"]


def test_a_box_that_is_no_number_is_an_error_and_not_dropped(tf, torch, picture):
    processor = tf.YolosImageProcessor(size={"height": 64, "width": 96})
    model = Drawing(tf, torch, [[0.5, float("nan"), 0.25, 0.5]])
    with pytest.raises(ValueError, match=r"results\[0\]: `xyxy` must be finite"):
        TransformersDetector(model, processor, threshold=0.5)(picture)


def test_a_processor_of_another_task_is_refused(tf):
    with pytest.raises(TypeError, match="must have post_process_object_detection"):
        TransformersDetector(None, tf.GLPNImageProcessor(), threshold=0.5)


@pytest.mark.parametrize("threshold", [50, -0.1, float("nan"), "0.5"])
def test_a_threshold_that_is_no_ratio_is_refused(threshold):
    processor = SimpleNamespace(post_process_object_detection=None)
    with pytest.raises((ValueError, TypeError), match="`threshold` must be between 0 and 1"):
        TransformersDetector(None, processor, threshold=threshold)


# --- depth that is already there ---


def test_the_kind_is_the_callers_and_metres_of_networks_have_a_scale_error():
    result = {"predicted_depth": np.full((3, 4), 2.5, dtype=np.float32), "depth": "a picture"}
    metric = depth_from(result, kind="metric")
    inverse = depth_from(result, kind="affine_inverse")
    assert (metric.kind, metric.scale_rel_std) == ("metric", 0.15)
    assert (inverse.kind, inverse.scale_rel_std) == ("affine_inverse", 0.0)
    assert depth_from(result, kind="metric", scale_rel_std=0.3).scale_rel_std == 0.3
    assert metric.values.dtype == np.float32
    assert metric.image_size == (4, 3)
    assert depth_from(result, kind="metric", image_size=(8, 6)).image_size == (8, 6)


def test_a_leading_axis_of_one_picture_is_dropped():
    values = np.arange(1.0, 13).reshape(1, 3, 4)
    assert np.array_equal(depth_from({"predicted_depth": values}, kind="metric").values, values[0])


def test_depth_tensors_of_every_float_type_and_with_gradients_are_read(torch):
    for dtype in (torch.float64, torch.float32, torch.float16, torch.bfloat16):
        tensor = torch.tensor([[2.5, 0.75]], dtype=dtype, requires_grad=True)
        assert depth_from({"predicted_depth": tensor}, kind="metric").values.tolist() == [
            [2.5, 0.75]
        ]


def test_depth_pros_sky_is_missing_in_every_float_type(torch):
    for dtype in (torch.float32, torch.float16, torch.bfloat16):
        inverse = torch.tensor([[0.0, 0.5]], dtype=dtype)
        tensor = 1 / inverse.clamp(min=1e-4, max=1e4)
        assert tensor.max() > 9000
        values = depth_from({"predicted_depth": tensor}, kind="metric").values
        assert np.isnan(values).tolist() == [[True, False]]


def test_other_kinds_have_no_sky():
    values = np.array([[20_000.0, 1.0]])
    assert depth_from({"predicted_depth": values}, kind="affine_inverse").values[0, 0] == 20_000


def test_metres_below_zero_that_resizing_makes_are_no_depth():
    with pytest.raises(ValueError, match="must hold a finite, positive number"):
        depth_from({"predicted_depth": np.array([[-2.2e-8, 0.0]])}, kind="metric")


def test_maps_are_copies():
    values = np.full((3, 4), 2.5)
    made = depth_from({"predicted_depth": values}, kind="relative")
    values[0, 0] = 9
    assert made.values[0, 0] == 2.5


@pytest.mark.parametrize(
    ("result", "error", "message"),
    [
        pytest.param({"depth": "a picture"}, ValueError, "stretched for display", id="display"),
        pytest.param({"logits": 1}, ValueError, r"got \['logits'\]\.$", id="other task"),
        pytest.param([{}], TypeError, r"Pass result\[0\]", id="list"),
        pytest.param(np.ones((3, 4)), TypeError, "got ndarray. Pass the pipeline", id="array"),
        pytest.param(
            {"predicted_depth": np.ones((2, 3, 4))}, ValueError, r"got \(2, 3, 4\)", id="several"
        ),
        pytest.param(
            {"predicted_depth": np.ones((3, 4)), "field_of_view": 40.0, "focal_length": None},
            ValueError,
            r"Pass target_sizes=",
            id="Depth Pro without the picture's size",
        ),
        pytest.param(
            {"predicted_depth": np.ones((3, 4)), "field_of_view": [40.0]},
            ValueError,
            r"Pass target_sizes=",
            id="Depth Pro as the model says it",
        ),
        pytest.param(
            {"predicted_depth": np.ones((3, 4), dtype=np.uint8)}, ValueError, "uint8", id="integers"
        ),
    ],
)
def test_results_that_hold_no_metres_are_refused(result, error, message):
    with pytest.raises(error, match=message):
        depth_from(result, kind="metric")


# --- what a model's configuration tells ---


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (depth_anything, "affine_inverse"),
        (depth_anything_metric, "metric"),
        (dpt, "affine_inverse"),
        (glpn, "metric"),
        (zoedepth, "metric"),
        (depth_pro, "metric"),
    ],
)
def test_the_configuration_tells_the_kind(make, kind, tf):
    model, _ = make(tf)
    assert kind_of(model.config) == kind


def test_tipsv2_counts_metres(tf):
    assert kind_of(tf.Tipsv2DptConfig()) == "metric"


@pytest.mark.parametrize("backbone", ["BeitConfig", "Swinv2Config"])
def test_midas_on_a_backbone_of_its_own_is_inverse(backbone, tf):
    config = tf.DPTConfig(backbone_config=getattr(tf, backbone)())
    assert kind_of(config) == "affine_inverse"


def test_configurations_that_do_not_tell_are_refused(tf):
    canopy, prompted = tf.CHMv2Config(), tf.PromptDepthAnythingConfig()
    on_dinov2 = tf.DPTConfig(backbone_config=tf.Dinov2Config(), add_projection=True)
    without_view = tf.DepthProConfig(use_fov_model=False)
    for config in (canopy, prompted, on_dinov2, without_view, tf.YolosConfig(), None):
        with pytest.raises(ValueError, match=r'pass kind=, one of "metric", "relative", "inverse"'):
            kind_of(config)


@pytest.mark.parametrize(
    "thin",
    [
        pytest.param({"model_type": "depth_anything"}, id="no type of depth"),
        pytest.param(
            {"model_type": "depth_anything", "depth_estimation_type": "Metric"}, id="odd type"
        ),
        pytest.param(
            {"model_type": "depth_anything", "depth_estimation_type": ["metric"]}, id="list"
        ),
        pytest.param({"model_type": "dpt"}, id="no backbone"),
        pytest.param(
            {"model_type": "dpt", "backbone_config": {"model_type": "dinov2"}}, id="bare backbone"
        ),
        pytest.param({"model_type": "depth_pro"}, id="no field of view"),
        pytest.param({"model_type": ["glpn"]}, id="a list for a name"),
        pytest.param({}, id="nothing"),
    ],
)
def test_a_thin_or_odd_configuration_does_not_tell(thin):
    with pytest.raises(ValueError, match="`kind` must be given where the model's configuration"):
        kind_of(SimpleNamespace(**thin))


def test_every_depth_model_of_transformers_was_looked_at(tf):
    known = set(tf.models.auto.modeling_auto.MODEL_FOR_DEPTH_ESTIMATION_MAPPING_NAMES)
    assert known >= {"depth_anything", "depth_pro", "dpt", "glpn", "zoedepth"}
    for name in known:
        assert name in kind_of.__doc__


# --- the depth network, run ---

NETWORKS = [depth_anything, depth_anything_metric, dpt, glpn]


@pytest.mark.parametrize("make", NETWORKS)
def test_the_runner_gives_the_pipelines_depth(make, pipe_of, picture):
    pipe = pipe_of("depth-estimation", make)
    with np.errstate(all="ignore"):  # the pipeline stretches its 8-bit picture by hand
        result = pipe(pil(picture))
    source = TransformersDepth(pipe.model, pipe.image_processor)
    depth = source(picture)
    theirs = result["predicted_depth"].numpy()
    clipped = (theirs <= 0) & (depth.kind == "affine_inverse")
    assert not clipped.all()
    np.testing.assert_array_equal(depth.values, np.where(clipped, np.nan, theirs))
    assert np.nanmax(depth.values) > np.nanmin(depth.values)
    np.testing.assert_array_equal(depth_from(result, kind=source.kind).values, depth.values)
    assert depth.kind == kind_of(pipe.model.config)
    assert depth.image_size == (200, 120)
    assert depth.scale_rel_std == (0.15 if depth.kind == "metric" else 0.0)


@pytest.mark.parametrize("make", NETWORKS)
def test_a_network_without_a_focal_length_has_no_camera(make, pipe_of, picture):
    pipe = pipe_of("depth-estimation", make)
    source = TransformersDepth(pipe.model, pipe.image_processor)
    depth, camera = source.with_camera(picture)
    np.testing.assert_array_equal(depth.values, source(picture).values)
    assert camera is None


def test_inverse_depth_that_the_network_clipped_at_zero_is_missing():
    result = {"predicted_depth": np.array([[0.0, -1e-9, 2.0]])}
    depth = depth_from(result, kind="affine_inverse")
    np.testing.assert_array_equal(depth.values, [[np.nan, np.nan, 2.0]])


def test_a_depth_model_in_bfloat16_is_fed_in_bfloat16(tf, torch, checkpoint, picture):
    folder = checkpoint(depth_anything_metric)
    model = tf.AutoModelForDepthEstimation.from_pretrained(folder, dtype=torch.bfloat16)
    exact = tf.AutoModelForDepthEstimation.from_pretrained(folder)
    processor = tf.AutoImageProcessor.from_pretrained(folder)
    coarse = TransformersDepth(model, processor)(picture).values
    fine = TransformersDepth(exact, processor)(picture).values
    assert np.abs(coarse / fine - 1).max() < 0.05


def test_a_declared_kind_and_scale_go_before_the_configurations(pipe_of, picture):
    pipe = pipe_of("depth-estimation", glpn)
    own = TransformersDepth(pipe.model, pipe.image_processor, kind="relative")
    assert own(picture).kind == "relative"
    assert own(picture).scale_rel_std == 0
    wide = TransformersDepth(pipe.model, pipe.image_processor, scale_rel_std=0.3)
    assert wide(picture).scale_rel_std == 0.3
    with pytest.raises(ValueError, match="`kind` must be one of"):
        TransformersDepth(pipe.model, pipe.image_processor, kind="metres")


def test_a_model_whose_kind_is_unknown_is_refused_before_it_runs(pipe_of):
    pipe = pipe_of("depth-estimation", glpn)
    stranger = SimpleNamespace(config=SimpleNamespace(model_type="new_depth"))
    with pytest.raises(ValueError, match="got model type 'new_depth'"):
        TransformersDepth(stranger, pipe.image_processor)
    assert TransformersDepth(stranger, pipe.image_processor, kind="inverse").kind == "inverse"


def test_a_processor_without_depth_is_refused(tf):
    with pytest.raises(TypeError, match="must have post_process_depth_estimation"):
        TransformersDepth(None, tf.YolosImageProcessor(), kind="metric")


def test_zoedepth_without_torchvision_says_what_is_missing(tf, checkpoint, picture):
    if importlib.util.find_spec("torchvision"):
        pytest.skip("torchvision is here")
    folder = checkpoint(zoedepth)
    model = tf.AutoModelForDepthEstimation.from_pretrained(folder)
    source = TransformersDepth(model, tf.AutoImageProcessor.from_pretrained(folder))
    with pytest.raises(ims.MissingDependencyError, match="needs the package 'torchvision'"):
        source(picture)


def test_zoedepths_own_output_is_read_as_metres(tf, torch):
    torch.manual_seed(0)
    model, _ = zoedepth(tf)
    with torch.inference_mode():
        output = model.eval()(torch.rand(1, 3, 64, 64))
    depth = depth_from(output, kind=kind_of(model.config), image_size=(200, 200))
    assert np.array_equal(depth.values, output.predicted_depth[0].numpy())
    assert 0.001 <= depth.values.min() <= depth.values.max() <= 10


@pytest.fixture(scope="module")
def depth_pro_run(tf, torch):
    torch.manual_seed(0)
    model, processor = depth_pro(tf)
    *_, last_bias = model.eval().fov_model.head.parameters()
    last_bias.data.fill_(40.0)  # degrees: an untrained network sees none
    square = np.random.default_rng(3).integers(0, 256, (128, 128, 3), dtype=np.uint8)
    with torch.inference_mode():
        raw = model(
            processor(square, return_tensors="pt", input_data_format="channels_last")[
                "pixel_values"
            ]
        )
    return TransformersDepth(model, processor), square, raw


def test_depth_pros_focal_length_becomes_a_camera(depth_pro_run):
    source, square, raw = depth_pro_run
    depth, camera = source.with_camera(square)
    half_view = np.radians(raw.field_of_view.item()) / 2
    assert camera.focal_px == pytest.approx(64 / np.tan(half_view), rel=1e-6)
    assert camera.focal_rel_std == 0.25
    assert camera.image_size == depth.image_size == (128, 128)


def test_depth_pros_field_of_view_cancels_from_its_sizes(depth_pro_run):
    source, square, raw = depth_pro_run
    depth, camera = source.with_camera(square)
    seen = np.isfinite(depth.values)
    canonical = raw.predicted_depth[0].numpy()
    assert np.array_equal(seen, canonical > 0)
    assert seen.mean() > 0.2
    metres_per_pixel = depth.values[seen] / camera.focal_px
    assert metres_per_pixel == pytest.approx(1 / (128 * canonical[seen]), rel=1e-5)


def test_depth_pro_as_the_model_says_it_is_refused_as_metres(depth_pro_run):
    source, _, raw = depth_pro_run
    with pytest.raises(ValueError, match="Pass target_sizes="):
        depth_from(raw, kind=source.kind)
    assert depth_from(raw, kind="inverse").kind == "inverse"


# --- both in the chain ---


def test_measure_takes_both_runners(pipe_of, picture):
    detector_pipe = pipe_of("object-detection", rt_detr)
    depth_pipe = pipe_of("depth-estimation", glpn)
    detector = TransformersDetector(
        detector_pipe.model, detector_pipe.image_processor, threshold=0.0
    )
    source = TransformersDepth(depth_pipe.model, depth_pipe.image_processor)
    result = ims.measure(picture, detector=detector, depth_source=source.with_camera)
    assert len(result.estimates) == len(result.detections) > 0
    assert result.depth.kind == "metric"


def test_orientation_is_applied_once_as_the_pipelines_do(pipe_of, picture, tmp_path):
    path = tmp_path / "turned.png"
    exif = pil(picture).getexif()
    exif[0x0112] = 6  # turn by 90 degrees to see it upright
    pil(picture).save(path, exif=exif)
    pipe = pipe_of("object-detection", detr)
    depth_pipe = pipe_of("depth-estimation", glpn)
    result = ims.measure(
        path,
        detector=TransformersDetector(pipe.model, pipe.image_processor, threshold=0.0),
        depth_source=TransformersDepth(depth_pipe.model, depth_pipe.image_processor),
    )
    whole = detections_from(pipe(str(path), threshold=0.0), image_size=(120, 200))
    assert result.image_size == (120, 200)
    lost = np.subtract([d.xyxy for d in result.detections], [d.xyxy for d in whole])
    assert np.abs(lost).max() < 1
    predicted = depth_pipe(str(path))["predicted_depth"].numpy()
    assert np.array_equal(result.depth.values, predicted)


def test_without_torch_the_runners_name_the_extra(monkeypatch, picture):
    def absent(name):
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(_optional.importlib, "import_module", absent)
    model = SimpleNamespace(config=SimpleNamespace(model_type="glpn"))
    processor = SimpleNamespace(
        post_process_object_detection=None, post_process_depth_estimation=None
    )
    runners = (
        TransformersDetector(model, processor, threshold=0.5),
        TransformersDepth(model, processor),
    )
    for runner in runners:
        with pytest.raises(ims.MissingDependencyError, match=r"'imgscale\[transformers\]'"):
            runner(picture)
