"""Results as one page for people: pictures, sizes, reservations and what repeats them."""

from __future__ import annotations

import html
import json
import math
from base64 import b64encode
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from io import BytesIO
from typing import Any, NamedTuple, cast

import numpy as np

from imgscale._checks import check_choice, check_iterable, check_type, within
from imgscale._format import PER_METRE, with_error
from imgscale._html import Column, Markup, element, joined, name_of, table
from imgscale._typing import ImageArray, ImageSize
from imgscale.estimate import SizeEstimate, central_scores, percent, size_texts, sizes_table
from imgscale.flags import Flag, flag_meanings, flag_words
from imgscale.measurement import Measurement
from imgscale.model import ScaleModel, references_table, summary
from imgscale.object_prior import ObjectPrior
from imgscale.picture import Picture, upright_rgb
from imgscale.plotting import draw_sizes
from imgscale.priors import PriorTable
from imgscale.reference import Reference, numbered_labels

__all__ = ["html_page"]

# A photo has ten inches, more where labels are many: 1600 px are sharp on dense screens.
_MOST_DPI = 160
_JPEG_QUALITY = 85
_MOST_NAMES = 6
_WHY_NOT = {"partial": "partly visible", "outlier": "contradicts the others"}


def html_page(
    results: Iterable[tuple[Measurement, Picture]],
    *,
    title: str = "imgscale",
    unit: str = "m",
    level: float = 0.9,
) -> str:
    """
    Write measurements as one HTML page that needs nothing else.

    For each picture: the picture with its objects, what the scale comes from, the sizes, the
    reservations with what they mean, and what the scale rests on in detail. With several pictures
    there is an overview first, and at the end of the page stands the record: one JSON text from
    which every model can be rebuilt. The page has no script, asks for nothing over the network,
    and follows the reader's light or dark mode.

    Parameters
    ----------
    results : iterable of (Measurement, picture)
        Each measurement with the picture that was measured: an upright (H, W, 3) ndarray of uint8,
        a path or a PIL image, as for `measure`. They are taken one after the other, and no picture
        is kept, so that a generator, or paths, serve any number of pictures.
    title : str
        Title and first heading of the page.
    unit : str
        Unit of the sizes: "m", "cm", "mm", "in" or "ft". Distances are in metres.
    level : float
        Probability that an interval holds the size, above 0 and below 1.

    Returns
    -------
    str
        The page, HTML5; write it as UTF-8. It is the same for the same results. A picture takes
        some 0.1 to 0.5 MB, up to 1600 px wide or high, or twice that where it is crowded, and half
        a second; the known sizes take 0.1 MB once. 200 photos of 12 megapixels, given one by one,
        make a page of 91 MB with 0.5 GB of memory.

    Raises
    ------
    TypeError
        If a result is no pair of a measurement and a picture.
    ValueError
        If there is no result, a picture is not the one that was measured, or an option breaks its
        law.
    OSError
        If a file is missing or no picture.
    MissingDependencyError
        If matplotlib is not installed.

    Notes
    -----
    A model is rebuilt from the record by ``record = json.loads(text)``,
    ``picture = record["pictures"][0]`` and ``ScaleModel.from_dict(picture["model"] | {"priors":
    record["priors"][picture["priors"]]})``: tables of sizes, which most pictures share, are there
    once.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.datasets import motorcycle
    >>> from imgscale.report import html_page
    >>> scene = motorcycle.load()
    >>> result = ims.measure(
    ...     scene.image,
    ...     detector=lambda image: scene.detections,
    ...     depth_source=lambda image: scene.depth,
    ...     priors=scene.priors,
    ...     noise=scene.noise,
    ... )
    >>> page = html_page([(result, scene.image)], title="In the garage", unit="cm")
    >>> "<h1>In the garage</h1>" in page, "46.7 ± 1.7 cm" in page
    (True, True)
    """
    _check_title(title)
    check_choice("unit", unit, tuple(PER_METRE))
    central_scores(level)
    check_iterable("results", results, "(Measurement, picture)")
    sections = [
        _section(index, *_checked_pair(index, result), unit, level)
        for index, result in enumerate(results)
    ]
    if not sections:
        msg = "`results` must hold at least one pair of a Measurement and its picture; got none."
        raise ValueError(msg)
    return _page(title, sections, {"unit": unit, "level": level})


class _Section(NamedTuple):
    """What the page keeps of one picture."""

    heading: Markup
    content: Markup
    overview: tuple[str, ...]
    record: dict[str, Any]
    model: ScaleModel


# --- checks --------------------------------------------------------------------------------------


def _check_title(title: object) -> None:
    if not check_type("title", title, str).strip():
        msg = f"`title` must not be blank; got {title!r}."
        raise ValueError(msg)


def _checked_pair(index: int, result: object) -> tuple[Measurement, ImageArray]:
    """Raise unless a result is a measurement and the picture that was measured."""
    place, kind = f"results[{index}]", type(result).__name__
    pair: Sequence[object] = cast("Any", result) if isinstance(result, (tuple, list)) else ()
    if len(pair) != 2 or not isinstance(pair[0], Measurement):
        msg = (
            f"`{place}` must be a pair of a Measurement and its picture; got {kind}. "
            "Put a single pair in a list."
        )
        raise TypeError(msg)
    with within(place):
        measurement, image = pair[0], upright_rgb(pair[1])
    size = (image.shape[1], image.shape[0])
    if size != measurement.image_size:
        width, height = measurement.image_size
        msg = (
            f"`{place}` must have the picture that was measured, {width} x {height} px and "
            f"upright; got one of {size[0]} x {size[1]} px."
        )
        raise ValueError(msg)
    return measurement, image


# --- one picture ---------------------------------------------------------------------------------


def _section(
    index: int, measurement: Measurement, image: ImageArray, unit: str, level: float
) -> _Section:
    names = numbered_labels([estimate.label for estimate in measurement.estimates])
    heading = name_of(measurement.name.strip() or f"Picture {index + 1}")
    model = measurement.model
    figure, by_number = _figure(names, measurement, image, unit, level)
    rows = [f"#{place} {name}" for place, name in enumerate(names, 1)] if by_number else names
    content = element(
        "section",
        element("h2", heading),
        figure,
        element("p", _basis(model), class_="basis"),
        _sizes(rows, measurement.estimates, unit, level),
        _reservations(names, measurement),
        _details(model),
        id=f"picture-{index + 1}",
    )
    words = ", ".join(flag_words(model.flags))
    record = measurement.to_dict()
    del record["model"]["priors"]  # most pictures share them
    overview = (_sources(model, _known_objects(model)), str(len(names)), words)
    return _Section(heading, content, overview, record, model)


def _basis(model: ScaleModel) -> Markup:
    """Say in a sentence what the scale comes from, and in another what was not used."""
    names = numbered_labels([ref.label for ref in model.references])
    pairs = list(zip(names, model.references, strict=True))
    used = [name_of(name) for name, ref in pairs if ref.used]
    rejected = [
        joined((name_of(name), f" ({_WHY_NOT.get(ref.reason, ref.reason)})"))
        for name, ref in pairs
        if _is_rejected(ref)
    ]
    objects = joined((_known_objects(model), " (", _listed(used), ")")) if used else ""
    sentence = joined(("The scale comes from ", _sources(model, objects), "."))
    return joined((sentence, " Not used: ", _listed(rejected), ".")) if rejected else sentence


def _is_rejected(ref: Reference) -> bool:
    """Tell whether an object of known size was not used."""
    return bool(ref.reason) and not math.isnan(ref.prior_m)


def _known_objects(model: ScaleModel) -> str:
    """Count the objects of known size that were used, nothing where there are none."""
    used = sum(ref.used for ref in model.references)
    known = used + sum(_is_rejected(ref) for ref in model.references)
    share = f"{used} of {known}" if known > used else f"{used}"
    return f"{share} known {'object' if known == 1 else 'objects'}" if used else ""


def _sources(model: ScaleModel, objects: str) -> Markup:
    """List what took part in the scale, after the objects."""
    ground = model.ground
    sources = (
        objects,
        f"those of {model.shared.n_frames - 1} other pictures" if model.shared else "",
        "the camera's focal length" if model.camera_is_witness else "",
        "the camera's height as given" if ground and ground.camera_height_m is not None else "",
        "the horizon as given" if ground and ground.horizon_px is not None else "",
    )
    return joined([source for source in sources if source], " and ")


def _listed(parts: Sequence[str]) -> Markup:
    """List the first ones and count the others."""
    hidden = len(parts) - _MOST_NAMES
    more = f" and {hidden} more" if hidden > 0 else ""
    return joined((joined(parts[:_MOST_NAMES], ", "), more))


def _figure(
    names: Sequence[str], measurement: Measurement, image: ImageArray, unit: str, level: float
) -> tuple[Markup, bool]:
    """Draw the objects on the picture; tell whether some had room for their number alone."""
    found = measurement
    axes: Any = draw_sizes(
        image, found.detections, found.estimates, model=found.model, unit=unit, level=level
    )
    figure = axes.figure
    dpi = min(figure.dpi, _MOST_DPI)
    width, height = (round(inches * dpi) for inches in figure.get_size_inches())
    if max(image.shape) > max(width, height):  # which matplotlib takes long and much memory for
        axes.images[0].set_data(_resized(image, (width, height)))
    written = BytesIO()
    figure.savefig(written, format="jpeg", dpi=dpi, pil_kwargs={"quality": _JPEG_QUALITY})
    picture = element(
        "img",
        src=Markup(f"data:image/jpeg;base64,{b64encode(written.getvalue()).decode()}"),
        alt=_alternative(names, found.estimates, unit, level),
        width=str(width),
        height=str(height),
    )
    return element("figure", picture), any(text.get_text().startswith("#") for text in axes.texts)


def _resized(image: ImageArray, size: ImageSize) -> ImageArray:
    from PIL import Image  # noqa: PLC0415 - as in `picture`

    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.LANCZOS))


def _alternative(
    names: Sequence[str], estimates: Sequence[SizeEstimate], unit: str, level: float
) -> str:
    sizes = [
        f"{name} {size_texts(estimate, unit, level)[0]}"
        for name, estimate in zip(names, estimates, strict=True)
    ]
    hidden = len(sizes) - _MOST_NAMES
    more = f" and {hidden} more" if hidden > 0 else ""
    objects = "1 object" if len(sizes) == 1 else f"{len(sizes)} objects"
    listed = f": {', '.join(sizes[:_MOST_NAMES])}{more}" if sizes else ""
    return f"The picture with {objects} in boxes{listed}."


def _sizes(
    names: Sequence[str], estimates: Sequence[SizeEstimate], unit: str, level: float
) -> Markup:
    heading = element("h3", "Sizes")
    if not estimates:
        return joined((heading, element("p", "No object was found in this picture.")))
    note = (
        "Each size with its standard error, and the interval that holds it with a probability of "
        f"{percent(level)}."
    )
    built = sizes_table(names, estimates, unit=unit, level=level)
    return joined((heading, element("p", note), built))


def _reservations(names: Sequence[str], measurement: Measurement) -> Markup:
    """List the flags of scale and sizes with what they mean and whom they concern."""
    owners: dict[Flag, list[Markup]] = {}
    for flag in Flag:
        concerned = [
            name_of(name)
            for name, estimate in zip(names, measurement.estimates, strict=True)
            if flag in estimate.flags
        ]
        if flag != Flag.REFERENCE and (concerned or flag in measurement.model.flags):
            owners[flag] = concerned
    items = [
        element("li", element("strong", *flag_words(flag)), _of(concerned), *flag_meanings(flag))
        for flag, concerned in owners.items()
    ]
    listed = element("ul", *items) if items else element("p", "None.")
    return joined((element("h3", "Reservations"), listed))


def _of(concerned: Sequence[Markup]) -> Markup:
    return joined((" (", _listed(concerned), "): ")) if concerned else Markup(": ")


# --- details -------------------------------------------------------------------------------------


def _details(model: ScaleModel) -> Markup:
    """Show what the scale rests on: the model, every reference, and the sources of sizes."""
    priors = _priors_used(model)
    parts = [element("p", summary(model).replace("+-", "±"))]
    parts += [references_table(model)] if model.references else []
    if priors:
        parts += [element("p", "Known sizes, with their spread and where they were read:")]
        parts += [_priors_table(priors)]
    return element("details", element("summary", "What the scale rests on"), *parts)


def _priors_used(model: ScaleModel) -> list[ObjectPrior]:
    """Find the rows of the table that the references were compared with."""
    rows = [
        row
        for ref in model.references
        if not math.isnan(ref.prior_m)
        for row in model.priors.lookup(ref.prior_label)
        if row.axis == ref.axis
    ]
    return list(dict.fromkeys(rows))


def _priors_table(priors: Sequence[ObjectPrior]) -> Markup:
    columns = (
        Column("object"),
        Column("size", numeric=True),
        Column("from and to"),
        Column("source"),
    )
    rows = [
        (
            name_of(row.label),
            f"{row.axis} {with_error(row.mean_m, row.std_m).replace('+-', '±')} m",
            row.spans,
            row.source,
        )
        for row in priors
    ]
    return table(columns, rows)


# --- the page ------------------------------------------------------------------------------------


def _page(title: str, sections: Sequence[_Section], options: dict[str, Any]) -> str:
    """Put head, overview, pictures and record together."""
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("title", title),
        element("style", _STYLE),
    )
    parts = (
        '<!DOCTYPE html>\n<html lang="en">',
        head,
        "<body>",
        element("header", element("h1", title)),
        _overview(sections) if len(sections) > 1 else "",
        "<main>",
        *(section.content for section in sections),
        "</main>",
        _footer(_record_text(sections, options)),
        "</body></html>\n",
    )
    return "".join(parts)  # at once: pages of many pictures are large


def _overview(sections: Sequence[_Section]) -> Markup:
    columns = (
        Column("picture"),
        Column("scale from"),
        Column("objects", numeric=True),
        Column("reservations"),
    )
    rows = [
        (element("a", section.heading, href=f"#picture-{number}"), *section.overview)
        for number, section in enumerate(sections, 1)
    ]
    return element("nav", element("h2", f"{len(sections)} pictures"), table(columns, rows))


def _footer(record: str) -> Markup:
    note = (
        "What repeats these results, as JSON: models with their options, boxes, sizes and the "
        "priors with their sources. One click selects all of it."
    )
    details = element(
        "details",
        element("summary", "Record"),
        element("p", note),
        element("pre", Markup(html.escape(record, quote=False)), tabindex="0"),
    )
    return element("footer", details, element("p", f"Made with imgscale {version('imgscale')}."))


def _record_text(sections: Sequence[_Section], options: dict[str, Any]) -> str:
    """Write down what repeats the results, every table of sizes once."""
    owners: dict[PriorTable, ScaleModel] = {}
    for section in sections:
        owners.setdefault(section.model.priors, section.model)
    places = {priors: place for place, priors in enumerate(owners)}
    record = {
        "imgscale": version("imgscale"),
        "options": options,
        "pictures": [
            {**section.record, "priors": places[section.model.priors]} for section in sections
        ],
        "priors": [model.to_dict()["priors"] for model in owners.values()],
    }
    return json.dumps(record, indent=1, allow_nan=False)


# Even a mistake in escaping could neither run nor fetch anything.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_STYLE = Markup("""
:root { --paper: #ffffff; --ink: #1b1d21; --soft: #565b63; --line: #d5d8de; --link: #0b57d0;
  --card: #f5f6f8; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #15171b; --ink: #e9eaee; --soft: #acb2bd; --line: #3b3f47; --link: #8ab4f8;
    --card: #1f2228; }
}
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0 auto; max-width: 62rem; padding: 1.5rem 1rem 3rem; background: var(--paper);
  color: var(--ink); font: 1rem/1.5 system-ui, sans-serif; }
h1, h2, p, li, pre { overflow-wrap: anywhere; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 1rem; }
h2 { font-size: 1.35rem; line-height: 1.3; margin: 0 0 0.75rem; }
h3 { font-size: 1.1rem; margin: 1.5rem 0 0.25rem; }
p, ul { margin: 0.5rem 0; }
ul { padding-left: 1.25rem; }
a { color: var(--link); }
section, nav, footer { border-top: 1px solid var(--line); margin-top: 2rem; padding-top: 1.25rem; }
figure { margin: 0; }
img { display: block; max-width: 100%; max-height: 90vh; width: auto; height: auto;
  border-radius: 6px; }
.basis { font-size: 1.1rem; }
table { font-variant-numeric: tabular-nums; margin: 0.5rem 0; }
th, td { padding: 0.35rem 1.25rem 0.35rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; }
thead th { color: var(--soft); font-weight: 400; }
tbody th { font-weight: 600; }
details { margin-top: 1.5rem; }
summary { cursor: pointer; font-weight: 600; padding: 0.5rem 0; }
pre { max-height: 24rem; overflow: auto; margin: 0.5rem 0; padding: 0.75rem; font-size: 1rem;
  white-space: pre-wrap; background: var(--card); border-radius: 6px; -webkit-user-select: all;
  user-select: all; }
footer p { color: var(--soft); }
@media (max-width: 40rem) {
  table, tbody, tr, th, td { display: block; }
  thead { display: none; }
  tbody tr { border-bottom: 1px solid var(--line); padding: 0.5rem 0; }
  tbody th, tbody td { border: 0; padding: 0.1rem 0; white-space: normal !important;
    text-align: left !important; overflow-wrap: anywhere; }
  tbody td { display: flow-root; padding-left: 7.75rem; }
  td::before { content: attr(data-title); float: left; width: 7rem; margin-left: -7.75rem;
    color: var(--soft); }
  td:empty { display: none; }
}
@media print {
  :root { --paper: #ffffff; --ink: #000000; --soft: #444444; --line: #999999; --link: #000000; }
  body { max-width: none; padding: 0; }
  section + section { break-before: page; }
  figure, tr, li { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  details { display: none; }
  img { max-height: 11cm; }
}
""")
