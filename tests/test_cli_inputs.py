"""``imgscale measure``: formats of detections, kinds of depth, and what belongs to which photo."""

import json

import numpy as np
import pytest
from PIL import Image

import imgscale as ims
from imgscale.cli import main
from imgscale.cli._photos import PHOTO_ENDINGS

WIDTH, HEIGHT = 640, 480
BOXES = {"door": (100.0, 48.0, 180.0, 240.0), "crate": (320.0, 120.0, 400.0, 216.0)}


def photo(path, size=(WIDTH, HEIGHT), **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, "#667755").save(path, **options)
    return path


def objects(path):
    """The objects of a JSON result, by label."""
    [record] = json.loads(path.read_text())
    return {row["label"]: row for row in record["objects"]}


def xywh(box):
    x1, y1, x2, y2 = box
    return [x1, y1, x2 - x1, y2 - y1]


def ratios(box):
    return [n / side for n, side in zip(xywh(box), [WIDTH, HEIGHT] * 2, strict=True)]


# --- formats ---


def coco(names=("a.jpg",), **size):
    return {
        "images": [{"id": i, "file_name": name, **size} for i, name in enumerate(names)],
        "categories": [{"id": i, "name": name} for i, name in enumerate(BOXES)],
        "annotations": [
            {"image_id": image, "category_id": i, "bbox": xywh(box)}
            for image in range(len(names))
            for i, box in enumerate(BOXES.values())
        ],
    }


def as_coco(folder):
    (folder / "found.json").write_text(json.dumps(coco(width=WIDTH, height=HEIGHT)))
    return ["found.json"]


def as_coco_results(folder):
    dataset = coco()
    results = dataset.pop("annotations")
    (folder / "dataset.json").write_text(json.dumps(dataset))
    (folder / "found.json").write_text(json.dumps([r | {"score": 0.9} for r in results]))
    return ["found.json", "--coco-images", str(folder / "dataset.json")]


def as_megadetector(folder):
    found = [
        {"category": str(i), "conf": 0.9, "bbox": ratios(box)}
        for i, box in enumerate(BOXES.values())
    ]
    text = {
        "images": [{"file": "a.jpg", "detections": found}],
        "detection_categories": {str(i): name for i, name in enumerate(BOXES)},
    }
    (folder / "found.json").write_text(json.dumps(text))
    return ["found.json"]


def as_rekognition(folder):
    sides = ("Left", "Top", "Width", "Height")
    labels = [
        {"Name": name, "Instances": [{"BoundingBox": dict(zip(sides, ratios(box), strict=True))}]}
        for name, box in BOXES.items()
    ]
    (folder / "a.json").write_text(json.dumps({"Labels": labels}))
    return ["a.json"]


def as_pascal_voc(folder):
    # pixels from 1, the last one included
    found = "".join(
        f"<object><name>{name}</name><bndbox><xmin>{x1 + 1:g}</xmin><ymin>{y1 + 1:g}</ymin>"
        f"<xmax>{x2:g}</xmax><ymax>{y2:g}</ymax></bndbox></object>"
        for name, (x1, y1, x2, y2) in BOXES.items()
    )
    size = f"<size><width>{WIDTH}</width><height>{HEIGHT}</height></size>"
    (folder / "a.xml").write_text(f"<annotation>{size}{found}</annotation>")
    return ["a.xml"]


def as_yolo(folder):
    lines = [
        f"{i} {x + w / 2} {y + h / 2} {w} {h}"
        for i, (x, y, w, h) in enumerate(map(ratios, BOXES.values()))
    ]
    (folder / "a.txt").write_text("\n".join(lines))
    (folder / "classes.names").write_text("\n".join(BOXES) + "\n\n")
    return ["a.txt", "--class-names", str(folder / "classes.names")]


def as_kitti(folder):
    lines = [
        f"{name} -1 -1 -10 {x1} {y1} {x2} {y2} -1 -1 -1 -1000 -1000 -1000 -10 0.9"
        for name, (x1, y1, x2, y2) in BOXES.items()
    ]
    (folder / "a.txt").write_text("\n".join(lines))
    return ["a.txt"]


def as_transformers(folder):
    corners = ("xmin", "ymin", "xmax", "ymax")
    found = [
        {"score": 0.9, "label": name, "box": dict(zip(corners, box, strict=True))}
        for name, box in BOXES.items()
    ]
    (folder / "a.json").write_text(json.dumps(found))
    return ["a.json"]


def as_transformers_columns(folder):
    found = {"boxes": list(BOXES.values()), "scores": [0.9, 0.8], "labels": [0, 1]}
    (folder / "a.json").write_text(json.dumps(found))
    (folder / "names.txt").write_text("\n".join(BOXES))
    return ["a.json", "--class-names", str(folder / "names.txt")]


FORMATS = {
    "coco": as_coco,
    "coco, results": as_coco_results,
    "megadetector": as_megadetector,
    "rekognition": as_rekognition,
    "pascal_voc": as_pascal_voc,
    "yolo": as_yolo,
    "kitti": as_kitti,
    "transformers": as_transformers,
    "transformers, columns": as_transformers_columns,
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_sizes(tmp_path, name):
    photo(tmp_path / "a.jpg")
    found, *more = FORMATS[name](tmp_path)
    out = tmp_path / "out.json"
    arguments = ["measure", str(tmp_path / "a.jpg"), "--ground-plane", "--format",
                 name.partition(",")[0], *more, "--out", str(out)]  # fmt: skip
    assert main([*arguments, "--detections", str(tmp_path / found)]) == 0
    ours = objects(out)
    boxes = [ims.Detection(label, box) for label, box in BOXES.items()]
    plane = ims.GroundPlane(image_size=(WIDTH, HEIGHT))
    theirs = ims.predict(ims.fit(boxes, plane), boxes)
    for estimate in theirs:
        assert ours[estimate.label]["size_m"] == pytest.approx(estimate.size_m, rel=1e-6)
        ends = [ours[estimate.label][end] for end in ("low_m", "high_m")]
        assert ends == pytest.approx(estimate.interval(0.9), rel=1e-6)
    if name.partition(",")[0] not in ("coco", "megadetector"):  # a folder with a file per photo
        assert main([*arguments, "--detections", str(tmp_path)]) == 0
        assert objects(out) == ours


def test_boxes_by_hand_join_those_of_a_file(tmp_path):
    photo(tmp_path / "a.jpg")
    [found] = as_kitti(tmp_path)
    out = tmp_path / "out.json"
    assert main(
        ["measure", str(tmp_path / "a.jpg"), "--ground-plane", "--detections",
         str(tmp_path / found), "--format", "kitti", "--box", "sign=10,100,40,200",
         "--out", str(out)]
    ) == 0  # fmt: skip
    assert list(objects(out)) == ["door", "crate", "sign"]


def test_outlines_become_masks_on_which_depth_is_read(tmp_path):
    # the crate's lower left half is at 4, what else its box shows at 8
    photo(tmp_path / "a.jpg")
    x1, y1, x2, y2 = BOXES["crate"]
    corners = np.array([(x1, y1), (x1, y2), (x2, y2)]) / (WIDTH, HEIGHT)
    line = " ".join(str(number) for number in corners.ravel())
    depth = np.full((HEIGHT, WIDTH), 4.0)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    depth[(columns - x1) / (x2 - x1) > (rows - y1) / (y2 - y1)] = 8.0
    depth[:, :200] = 4.0
    np.save(tmp_path / "depth.npy", depth)
    x, y, width, height = ratios(BOXES["door"])
    door = f"{x + width / 2} {y + height / 2} {width} {height}"
    (tmp_path / "a.txt").write_text(f"0 {door}\n1 {line}\n")
    (tmp_path / "names.txt").write_text("door\ncrate")
    out = tmp_path / "out.json"
    assert main(
        ["measure", str(tmp_path / "a.jpg"), "--depth", str(tmp_path / "depth.npy"), "--kind",
         "relative", "--detections", str(tmp_path / "a.txt"), "--format", "yolo", "--masks",
         "--class-names", str(tmp_path / "names.txt"), "--out", str(out)]
    ) == 0  # fmt: skip
    found = objects(out)
    assert found["crate"]["size_m"] / found["door"]["size_m"] == pytest.approx(96 / 192, rel=0.02)


def test_detections_below_the_least_score_are_left_out(tmp_path):
    photo(tmp_path / "a.jpg")
    found, *more = as_transformers_columns(tmp_path)
    arguments = ["measure", str(tmp_path / "a.jpg"), "--ground-plane", "--detections",
                 str(tmp_path / found), "--format", "transformers", *more,
                 "--out", str(tmp_path / "out.json")]  # fmt: skip
    assert main([*arguments, "--min-score", "0.85"]) == 0
    assert list(objects(tmp_path / "out.json")) == ["door"]


def test_pixels_counted_from_0_need_to_be_told(tmp_path, capsys):
    photo(tmp_path / "a.jpg")
    corners = {"door": (300, 48, 380, 240), "crate": (0, 120, 80, 216)}
    names = ("xmin", "ymin", "xmax", "ymax")
    found = "".join(
        f"<object><name>{label}</name><bndbox>"
        + "".join(f"<{name}>{n}</{name}>" for name, n in zip(names, box, strict=True))
        + "</bndbox></object>"
        for label, box in corners.items()
    )
    text = f"<annotation>{found}</annotation>"
    (tmp_path / "a.xml").write_text(text)
    arguments = ["measure", str(tmp_path / "a.jpg"), "--ground-plane", "--detections",
                 str(tmp_path / "a.xml"), "--format", "pascal_voc"]  # fmt: skip
    assert main(arguments) == 1
    assert capsys.readouterr().err.rstrip().endswith("give --zero-based.")
    assert main([*arguments, "--zero-based", "--out", str(tmp_path / "o.json")]) == 0
    assert objects(tmp_path / "o.json")["crate"]["x1"] == 0


@pytest.mark.parametrize("name", ["coco", "pascal_voc"])
def test_boxes_of_a_smaller_copy_of_the_photo_are_refused(tmp_path, capsys, name):
    photo(tmp_path / "a.jpg", (2 * WIDTH, 2 * HEIGHT))
    [found] = FORMATS[name](tmp_path)
    code = main(
        ["measure", str(tmp_path / "a.jpg"), "--ground-plane", "--detections",
         str(tmp_path / found), "--format", name]
    )  # fmt: skip
    assert code == 1
    assert "must tell the photo's size, 1280 x 960 px; it says 640 x 480" in capsys.readouterr().err


def test_turned_photos_are_measured_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    photo(tmp_path / "a.jpg", (HEIGHT, WIDTH), exif=exif)  # stored lying
    [found] = as_megadetector(tmp_path)
    out = tmp_path / "out.json"
    code = main(
        ["measure", str(tmp_path / "a.jpg"), "--ground-plane", "--detections",
         str(tmp_path / found), "--format", "megadetector", "--out", str(out)]
    )  # fmt: skip
    assert code == 0
    crate = objects(out)["crate"]
    assert [crate[name] for name in ("x1", "y1", "x2", "y2")] == pytest.approx(BOXES["crate"])


def test_photos_that_megadetector_does_not_turn_are_refused(tmp_path, capsys):
    exif = Image.Exif()
    exif[0x0112] = 5
    photo(tmp_path / "a.jpg", (HEIGHT, WIDTH), exif=exif)
    [found] = as_megadetector(tmp_path)
    code = main(
        ["measure", str(tmp_path / "a.jpg"), "--ground-plane", "--detections",
         str(tmp_path / found), "--format", "megadetector"]
    )  # fmt: skip
    assert code == 2
    assert "images[0]" in capsys.readouterr().err


# --- folders ---


def test_a_folder_gives_its_photos_in_order_and_those_of_its_subfolders(tmp_path, capsys):
    names = ["b.JPG", "a.png", "cards/2/x.jpeg", "cards/1/x.jpeg"]
    for name in names:
        photo(tmp_path / "in" / name)
    photo(tmp_path / "in" / ".thumbs" / "t.jpg")
    photo(tmp_path / "in" / ".hidden.jpg")
    (tmp_path / "in" / "notes.md").write_text("no photo")
    (tmp_path / "found.json").write_text(json.dumps(coco(names)))
    code = main(
        ["measure", str(tmp_path / "in"), str(tmp_path / "in" / "b.JPG"), "--ground-plane",
         "--detections", str(tmp_path / "found.json"), "--format", "coco"]
    )  # fmt: skip
    assert code == 0
    lines = capsys.readouterr().out.splitlines()
    told = [line for line in lines if line.startswith(str(tmp_path))]
    assert told == [str(tmp_path / "in" / name) for name in sorted(names)]


def test_depth_maps_inside_the_folder_are_no_photos(tmp_path, capsys):
    photo(tmp_path / "in" / "a.jpg")
    as_transformers(tmp_path / "in")
    (tmp_path / "in" / "depth").mkdir()
    Image.fromarray(np.full((HEIGHT, WIDTH), 4000, np.uint16)).save(tmp_path / "in/depth/a.png")
    code = main(
        ["measure", str(tmp_path / "in"), "--depth", str(tmp_path / "in" / "depth"), "--kind",
         "metric", "--scale", "1000", "--detections", str(tmp_path / "in"), "--format",
         "transformers"]
    )  # fmt: skip
    captured = capsys.readouterr()
    assert (code, captured.err) == (0, "")
    assert captured.out.count("a.jpg") == 1


def test_a_folder_without_photos_is_an_error(tmp_path, capsys):
    code = main(["measure", str(tmp_path), "--ground-plane", "--box", "door=1,2,3,4"])
    assert code == 2
    assert all(ending in capsys.readouterr().err for ending in PHOTO_ENDINGS[:1])


def test_files_are_found_by_the_longest_end_of_the_path(tmp_path):
    for card, door in (("1", BOXES["door"]), ("2", BOXES["crate"])):
        photo(tmp_path / "in" / card / "x.jpg")
        box = dict(zip(("xmin", "ymin", "xmax", "ymax"), door, strict=True))
        found = [{"score": 1, "label": "door", "box": box}]
        (tmp_path / "labels" / card).mkdir(parents=True)
        (tmp_path / "labels" / card / "x.json").write_text(json.dumps(found))
    (tmp_path / "labels" / "x.json").write_text("[]")  # shorter
    out = tmp_path / "out.json"
    code = main(
        ["measure", str(tmp_path / "in"), "--ground-plane", "--detections",
         str(tmp_path / "labels"), "--format", "transformers", "--out", str(out)]
    )  # fmt: skip
    assert code == 0
    assert [record["objects"][0]["x1"] for record in json.loads(out.read_text())] == [100, 320]


@pytest.mark.parametrize("form", ["coco", "megadetector", "transformers"])
def test_an_entry_that_would_serve_several_photos_serves_none(tmp_path, capsys, form):
    names = ["1/a.jpg", "2/a.jpg", "a.jpg"]
    for name in [*names, "b.jpg"]:
        photo(tmp_path / "in" / name)
    found = tmp_path / FORMATS[form](tmp_path)[0]
    if form == "transformers":
        (tmp_path / "b.json").write_text(found.read_text())
    else:
        data = json.loads(found.read_text())
        key = "file_name" if form == "coco" else "file"
        data["images"].append(data["images"][0] | {"id": 1, key: "b.jpg"})
        data["annotations"] = [
            entry | {"image_id": i} for i in (0, 1) for entry in data.get("annotations", [])
        ]
        found.write_text(json.dumps(data))
    source = tmp_path if form == "transformers" else found
    code = main(
        ["measure", str(tmp_path / "in"), "--ground-plane", "--detections", str(source),
         "--format", form]
    )  # fmt: skip
    captured = capsys.readouterr()
    assert code == 1
    lines = captured.err.splitlines()
    assert len(lines) == 3
    for line, name in zip(lines, names, strict=True):
        itself, others = line.split("would serve ")
        assert itself.startswith(f"imgscale: {tmp_path / 'in' / name}: ")
        assert others.split(" too;")[0] in {str(tmp_path / "in" / n) for n in names if n != name}
    assert captured.out.startswith(f"{tmp_path / 'in' / 'b.jpg'}\n")
    assert captured.out.count(".jpg") == 1


def test_boxes_of_megadetector_take_the_size_of_their_own_photo(tmp_path, capsys):
    photo(tmp_path / "in" / "a" / "1.jpg")
    photo(tmp_path / "in" / "b" / "1.jpg", (2 * WIDTH, 2 * HEIGHT))
    as_megadetector(tmp_path)
    data = json.loads((tmp_path / "found.json").read_text())
    [entry] = data["images"]
    words = ["measure", str(tmp_path / "in"), "--ground-plane", "--detections",
             str(tmp_path / "found.json"), "--format", "megadetector",
             "--out", str(tmp_path / "out.json")]  # fmt: skip
    for longer in "ab":  # which leaves the shorter name to the other photo
        data["images"] = [entry | {"file": "1.jpg"}, entry | {"file": f".\\{longer}\\1.jpg"}]
        (tmp_path / "found.json").write_text(json.dumps(data))
        assert main(words) == 0
        for record, factor in zip(
            json.loads((tmp_path / "out.json").read_text()), (1, 2), strict=True
        ):
            door = record["objects"][0]
            corners = [door[name] / factor for name in ("x1", "y1", "x2", "y2")]
            assert corners == pytest.approx(BOXES["door"])
    data["images"] = [entry | {"file": "1.jpg"}]
    (tmp_path / "found.json").write_text(json.dumps(data))
    assert main(words) == 2
    assert "would serve" in capsys.readouterr().err


def test_a_photo_that_megadetector_could_not_read_is_told_so(tmp_path, capsys):
    photo(tmp_path / "in" / "a.jpg")
    photo(tmp_path / "in" / "b.jpg")
    as_megadetector(tmp_path)
    data = json.loads((tmp_path / "found.json").read_text())
    data["images"].append({"file": "b.jpg", "failure": "Failure image access"})
    (tmp_path / "found.json").write_text(json.dumps(data))
    code = main(
        ["measure", str(tmp_path / "in"), "--ground-plane", "--detections",
         str(tmp_path / "found.json"), "--format", "megadetector"]
    )  # fmt: skip
    assert code == 1
    assert capsys.readouterr().err == (
        f"imgscale: {tmp_path / 'in' / 'b.jpg'}: MegaDetector could not read it: "
        "Failure image access.\n"
    )


def test_a_link_to_a_photo_goes_by_its_own_name(tmp_path, capsys):
    photo(tmp_path / "store" / "ab12.jpg")
    (tmp_path / "in").mkdir()
    link = tmp_path / "in" / "a.jpg"
    link.symlink_to(tmp_path / "store" / "ab12.jpg")
    [found] = as_transformers(tmp_path)
    (tmp_path / "labels").mkdir()
    (tmp_path / found).rename(tmp_path / "labels" / found)
    code = main(
        ["measure", str(tmp_path / "in"), str(tmp_path / "in" / ".." / "in" / "a.jpg"),
         "--ground-plane", "--detections", str(tmp_path / "labels"), "--format", "transformers"]
    )  # fmt: skip
    captured = capsys.readouterr()
    assert (code, captured.err) == (0, "")
    assert captured.out.count(str(link)) == 1


@pytest.mark.parametrize("form", ["coco", "transformers"])
def test_a_photo_without_detections_is_named_and_the_others_are_measured(tmp_path, capsys, form):
    photo(tmp_path / "in" / "a.jpg")
    photo(tmp_path / "in" / "b.jpg")
    found = tmp_path / FORMATS[form](tmp_path)[0]
    code = main(
        ["measure", str(tmp_path / "in"), "--ground-plane", "--detections",
         str(found if form == "coco" else tmp_path), "--format", form]
    )  # fmt: skip
    captured = capsys.readouterr()
    assert code == 1
    [line] = captured.err.splitlines()
    assert line.startswith(f"imgscale: {tmp_path / 'in' / 'b.jpg'}: ")
    assert "a.jpg" in captured.out


@pytest.mark.parametrize("form", ["coco", "megadetector", "transformers"])
def test_detections_of_none_of_the_photos_are_wrong_usage(tmp_path, capsys, form):
    for name in "xyz":
        photo(tmp_path / "in" / f"{name}.jpg")
    found = tmp_path / FORMATS[form](tmp_path)[0]
    code = main(
        ["measure", str(tmp_path / "in"), "--ground-plane", "--detections",
         str(tmp_path if form == "transformers" else found), "--format", form]
    )  # fmt: skip
    captured = capsys.readouterr()
    assert (code, captured.out) == (2, "")
    [line] = captured.err.splitlines()
    assert "holds none of the photos" in line
    assert "So it is for 2 more photos." in line


# --- depth ---


def metric_scene(tmp_path, focal_px=500.0):
    """A door of 2 m at 5 m and a crate of 0.5 m at 2.5 m, in metres."""
    depth = np.full((HEIGHT, WIDTH), 5.0)
    depth[:, 250:] = 2.5
    boxes = {
        "door": (100, 100, 180, 100 + 2.0 * focal_px / 5),
        "crate": (320, 120, 400, 120 + 0.5 * focal_px / 2.5),
    }
    arguments = ["measure", str(photo(tmp_path / "a.jpg")), "--reference", "door=2.0",
                 "--out", str(tmp_path / "out.json")]  # fmt: skip
    for name, box in boxes.items():
        arguments += ["--box", f"{name}={','.join(map(str, box))}"]
    return depth, arguments


def save_depth(path, depth, kind):
    """The same scene in every kind and every file."""
    values = {
        "metric": depth,
        "relative": 7.3 * depth,
        "inverse": 40 / depth,
        "affine_inverse": 40 / depth,
    }[kind]
    ending = path.suffix
    if ending == ".npy":
        np.save(path, values)
    elif ending == ".npz":
        np.savez(path, depth=values, other=values[:1])
    elif ending == ".pfm":
        header = f"Pf\n{WIDTH} {HEIGHT}\n-1.0\n".encode()
        path.write_bytes(header + values[::-1].astype("<f4").tobytes())
    elif ending == ".png":
        Image.fromarray(np.round(values * 1000).astype(np.uint16)).save(path)
    else:
        Image.fromarray(values.astype(np.float32)).save(path)


@pytest.mark.parametrize(
    ("kind", "ending", "more"),
    [
        ("metric", ".npy", []),
        ("metric", ".png", ["--scale", "1000"]),
        ("relative", ".npz", ["--depth-key", "depth"]),
        ("relative", ".tif", []),
        ("inverse", ".pfm", []),
    ],
)
def test_every_kind_and_file_of_depth_gives_the_true_size(tmp_path, kind, ending, more):
    depth, arguments = metric_scene(tmp_path)
    save_depth(tmp_path / f"depth{ending}", depth, kind)
    depth_file = str(tmp_path / f"depth{ending}")
    assert main([*arguments, "--depth", depth_file, "--kind", kind, *more]) == 0
    crate = objects(tmp_path / "out.json")["crate"]
    assert crate["size_m"] == pytest.approx(0.5, rel=0.01)
    assert crate["low_m"] < 0.5 < crate["high_m"]


def test_a_shift_is_fitted_where_references_tell_it(tmp_path):
    depth = np.full((HEIGHT, WIDTH), 5.0)
    depth[:, 200:300], depth[:, 300:] = 10.0, 2.5
    np.save(tmp_path / "d.npy", 40 / depth - 1.5)
    arguments = ["measure", str(photo(tmp_path / "a.jpg")), "--depth", str(tmp_path / "d.npy"),
                 "--kind", "affine_inverse", "--reference", "door=2.0", "--depth-rel-std", "0.01",
                 "--out", str(tmp_path / "out.json")]  # fmt: skip
    for box in ("door=100,100,180,300", "door=210,100,260,200", "crate=320,120,400,220"):
        arguments += ["--box", box]
    assert main(arguments) == 0
    assert objects(tmp_path / "out.json")["crate"]["size_m"] == pytest.approx(0.5, rel=0.05)


def test_one_distance_puts_all_at_one(tmp_path):
    arguments = ["measure", str(photo(tmp_path / "a.jpg")), "--one-distance", "--reference",
                 "coin=23.25mm diameter", "--box", "coin=10,10,60,60", "--box",
                 "disc=100,100,260,270", "--axis", "diameter", "--unit", "mm",
                 "--out", str(tmp_path / "out.json")]  # fmt: skip
    assert main(arguments) == 0
    disc = objects(tmp_path / "out.json")["disc"]
    assert disc["size_mm"] == pytest.approx(23.25 * 170 / 50, rel=1e-3)


@pytest.mark.parametrize(
    ("make", "more", "message"),
    [
        (lambda path: np.save(path, np.full((4, 4), 4000, np.uint16)), [], "--scale must be given"),
        (lambda path: path.write_bytes(b"no array"), [], "cannot be read as NPY"),
        (lambda path: np.save(path, np.full((4, 4), np.nan)), [], "map is empty"),
        (lambda path: np.save(path, np.ones((4, 4, 3))), [], "must hold one channel"),
        (lambda path: np.save(path, np.ones((WIDTH, HEIGHT))), [], "transpose the map"),
        (lambda path: np.save(path, np.ones((4, 4))), ["--depth-key", "z"], "--depth-key must be"),
    ],
    ids=["integers", "broken", "empty", "coloured", "lying", "key"],
)  # fmt: skip
def test_depth_that_cannot_be_is_told_with_its_file(tmp_path, capsys, make, more, message):
    _, arguments = metric_scene(tmp_path)
    make(tmp_path / "d.npy")
    depth = ["--depth", str(tmp_path / "d.npy"), "--kind", "metric"]
    assert main([*arguments, *depth, *more]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"imgscale: {tmp_path / 'a.jpg'}: ")
    assert message in line
    assert "d.npy" in line
    assert not (tmp_path / "out.json").exists()


def test_two_depth_files_of_one_photo_are_an_error(tmp_path, capsys):
    depth, arguments = metric_scene(tmp_path)
    (tmp_path / "d").mkdir()
    for ending in (".npy", ".pfm"):
        save_depth(tmp_path / "d" / f"a{ending}", depth, "metric")
    assert main([*arguments, "--depth", str(tmp_path / "d"), "--kind", "metric"]) == 2
    assert "leave one for each photo" in capsys.readouterr().err


# --- camera ---


def with_exif(path, focal_mm):
    record = Image.Exif()
    record[0x8769] = {0xA405: focal_mm}
    photo(path, exif=record)


def test_the_focal_length_comes_from_exif_by_default_and_gives_distances(tmp_path):
    focal_px = 28 * np.hypot(WIDTH, HEIGHT) / np.hypot(36, 24)
    depth, arguments = metric_scene(tmp_path, focal_px)
    np.save(tmp_path / "d.npy", 3 * depth)
    arguments += ["--depth", str(tmp_path / "d.npy"), "--kind", "relative"]
    out = tmp_path / "out.json"
    assert main(arguments) == 0
    assert objects(out)["crate"]["distance_m"] is None
    with_exif(tmp_path / "a.jpg", 28)
    assert main(arguments) == 0
    assert objects(out)["crate"]["distance_m"] == pytest.approx(2.5, rel=0.02)
    [record] = json.loads(out.read_text())
    assert record["model"]["camera"]["focal_rel_std"] == 0.04
    assert main([*arguments, "--no-exif"]) == 0
    assert objects(out)["crate"]["distance_m"] is None
    assert main([*arguments, "--focal-px", str(2 * focal_px)]) == 0
    assert objects(out)["crate"]["distance_m"] == pytest.approx(5.0, rel=0.02)
    [record] = json.loads(out.read_text())
    assert record["model"]["camera"]["focal_rel_std"] == 0.02


def test_what_is_told_of_camera_and_ground_is_what_fit_gets(tmp_path):
    out = tmp_path / "out.json"
    code = main(
        ["measure", str(photo(tmp_path / "a.jpg")), "--ground-plane", "--camera-height", "1.6",
         "--camera-height-std", "0.05", "--horizon", "120", "--horizon-std", "9", "--focal-px",
         "500", "--focal-rel-std", "0.03", "--pitch-deg", "14", "--pitch-std-deg", "2",
         "--box-std-px", "2", "--box-rel-std", "0.04", "--depth-rel-std", "0.01", "--method",
         "robust", "--region", "eu", "--box", "door=100,100,160,300", "--box",
         "crate=300,250,400,330", "--out", str(out)]
    )  # fmt: skip
    assert code == 0
    [record] = json.loads(out.read_text())
    ours = ims.ScaleModel.from_dict(record["model"])
    boxes = [
        ims.Detection("door", (100, 100, 160, 300)),
        ims.Detection("crate", (300, 250, 400, 330)),
    ]
    size = (WIDTH, HEIGHT)
    theirs = ims.fit(
        boxes,
        ims.GroundPlane(image_size=size, camera_height_m=1.6, camera_height_std_m=0.05,
                        horizon_px=120, horizon_std_px=9),
        ims.PriorTable.default("eu"),
        camera=ims.Camera(500, focal_rel_std=0.03, pitch_deg=14, pitch_std_deg=2, image_size=size),
        method="robust",
        noise=ims.Noise(2, 0.04, 0.01),
    )  # fmt: skip
    assert ours == theirs


def test_a_table_takes_the_place_of_the_shipped_one(tmp_path, capsys):
    table = ims.PriorTable([ims.ObjectPrior("crate", 0.4, 0.01)])
    table.to_csv(tmp_path / "mine.csv")
    arguments = ["measure", str(photo(tmp_path / "a.jpg")), "--one-distance", "--box",
                 "door=100,48,180,240", "--box", "crate=320,120,400,216",
                 "--out", str(tmp_path / "out.json")]  # fmt: skip
    assert main([*arguments, "--priors", str(tmp_path / "mine.csv")]) == 0
    door = objects(tmp_path / "out.json")["door"]
    assert door["flags"] == ""
    assert door["size_m"] == pytest.approx(0.8, rel=1e-3)
    (tmp_path / "mine.csv").write_text("label,mean_m,std_m\ncrate,wide,0\n")
    assert main([*arguments, "--priors", str(tmp_path / "mine.csv")]) == 2
    assert "line 2" in capsys.readouterr().err


# --- which options go together ---

BOX = "a.jpg --box door=1,2,3,4"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("a.jpg --ground-plane", "--detections or --box must say"),
        ("a.jpg --ground-plane --detections x", "--detections and --format must be given"),
        (f"{BOX} --ground-plane --format coco", "--detections and --format must be given"),
        (f"b.jpg {BOX} --ground-plane", "--box must be for one photo; got 2"),
        (f"{BOX} --depth d.npy", "--depth and --kind must be given together"),
        (f"{BOX} --ground-plane --kind metric", "--depth and --kind must be given together"),
        (f"{BOX} --ground-plane --scale 2", "--scale must go with --depth"),
        (f"{BOX} --depth d.npy --kind metric --horizon 9", "--horizon must go with --ground-plane"),
        (f"{BOX} --depth none.npy --kind metric", "file or folder; there is no none.npy"),
        (f"{BOX} --one-distance --camera-height 2", "--camera-height must go with --ground-plane"),
        (f"{BOX} --ground-plane --camera-height-std 2", "must come with --camera-height"),
        (f"{BOX} --ground-plane --horizon-std 2", "--horizon-std must come with --horizon"),
        (f"{BOX} --ground-plane --pitch-deg 2", "--pitch-deg must come with --focal-px"),
        (f"{BOX} --ground-plane --focal-rel-std 0", "--focal-rel-std must come with --focal-px"),
        (f"{BOX} --ground-plane --focal-px 9 --pitch-std-deg 2", "must come with --pitch-deg"),
        (
            f"{BOX} --depth d.npy --kind relative --scale-rel-std 0.2",
            "--scale-rel-std must go with --kind metric",
        ),
        (f"{BOX} --depth a.jpg --kind metric", "--depth must end in .npy or"),
        (
            f"{BOX} --ground-plane --method mean_ratio",
            "must be posterior or robust with --ground-plane; got mean_ratio",
        ),
        (
            f"{BOX} --depth d.npy --kind affine_inverse --method least_squares",
            "must be posterior or robust with --kind affine_inverse; got least_squares",
        ),
        (
            f"{BOX} --one-distance --focal-px 900 --pitch-deg 2 --method mean_ratio",
            "must be posterior or robust with --pitch-deg; got mean_ratio",
        ),
        (f"{BOX} --ground-plane --masks", "must go with --format coco or yolo; got None"),
        (f"{BOX} --ground-plane --reference door=2 --reference Door=2.1", 'name "door" once'),
        (f"{BOX} --ground-plane --reference gate=2", 'reference "gate" must be something that'),
        (f"{BOX} --ground-plane --priors none.csv", "none.csv: No such file"),
        ("a.jpg --ground-plane --detections x --format yolo", "--class-names must be given with"),
        (
            "a.jpg --ground-plane --detections x --format kitti --zero-based",
            "--zero-based must go with --format pascal_voc; got kitti",
        ),
        ("a.jpg --ground-plane --detections x --format coco", "there is no file x"),
        ("a.jpg --ground-plane --detections x --format kitti", "there is no x"),
        (
            "a.jpg b.jpg --ground-plane --detections a.jpg --format kitti",
            "must be a folder, with a file for each of the 2 photos",
        ),
    ],
)
def test_options_that_do_not_go_together_are_told_in_one_line(
    tmp_path, monkeypatch, capsys, words, message
):
    monkeypatch.chdir(tmp_path)
    photo(tmp_path / "a.jpg")
    assert main(["measure", *words.split()]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    [line] = captured.err.splitlines()
    assert line.startswith("imgscale: ")
    assert message in line


@pytest.mark.parametrize(
    "text",
    [
        "door\n\ncrate\n", "{0: door}\n", "names:\n  0: door\n  1: crate\n", "0: door\n1: crate\n",
        "- door\n- crate\n", '["door", "crate"]\n', "d\xf6or\ncrate",
    ],
)  # fmt: skip
def test_class_names_of_another_form_are_refused(tmp_path, capsys, text):
    name = "names.txt"
    photo(tmp_path / "a.jpg")
    found, *_ = as_yolo(tmp_path)
    (tmp_path / name).write_text(text, encoding="latin-1")
    code = main(
        ["measure", str(tmp_path / "a.jpg"), "--ground-plane", "--detections",
         str(tmp_path / found), "--format", "yolo", "--class-names", str(tmp_path / name)]
    )  # fmt: skip
    assert code == 2
    error = capsys.readouterr().err
    assert "a name a line" in error
    assert "codec" not in error
