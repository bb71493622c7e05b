"""Makes scans and photographs of sheets: rotation or perspective, blur, noise, uneven paper, JPEG."""

import math

import numpy

from .styles import LANGUAGES

SCAN_TRAITS = {"thick_mm": (0.35, 0.5, 0.5, 0.7), "is_colour": (False, False, True)}
# Width in pixels of the pictures of telephones.
PHOTO_WIDTH = 4000


def choose_scan(dice, dpi):
    """Traits of a picture; `dpi` is the resolution of a scan, or 0 for a photograph."""
    traits = {name: dice.choice(values) for name, values in SCAN_TRAITS.items()}
    traits |= {
        "dpi": dpi,
        "rotation_deg": dice.uniform(-2, 2),
        "blur_px": dice.uniform(0.5, 1.5),
        "jpeg": dice.randint(50, 90),
        "noise": dice.uniform(1.5, 6.0),
        "shade": dice.uniform(0.0, 0.25),
        "paper": dice.uniform(0.8, 0.98),
        "ink": dice.uniform(0.05, 0.3),
    }
    if not dpi:
        traits["tilt_deg"] = dice.uniform(4, 20)
        traits["tilt_towards_deg"] = dice.uniform(0, 360)
        # Distance of the camera in diagonals of the page: a usual lens.
        traits["distance"] = dice.uniform(1.1, 1.6)
        traits["fill"] = dice.uniform(0.75, 0.9)
    return traits


def set_line_widths(doc, language, thick):
    """Visible lines and the frame are wide, all others half as wide (ISO 128)."""
    layers = LANGUAGES[language].layers
    wide_layers = {layers["visible"], layers["frame"]}
    for entity in doc.entitydb.values():
        if not (entity.is_alive and entity.dxf.is_supported("lineweight") and hasattr(entity.dxf, "layer")):
            continue
        on_zero = entity.dxf.layer == "0" and entity.dxf.get("color") == 7
        is_wide = entity.dxf.layer in wide_layers or on_zero
        entity.dxf.lineweight = round(100 * (thick if is_wide else thick / 2))
    # Weights of the format have steps.
    steps = (13, 15, 18, 20, 25, 30, 35, 40, 50, 53, 60, 70)
    for entity in doc.entitydb.values():
        if entity.is_alive and entity.dxf.is_supported("lineweight") and entity.dxf.hasattr("lineweight"):
            own = entity.dxf.lineweight
            if own > 0:
                entity.dxf.lineweight = min(steps, key=lambda s: abs(s - own))


def rendered(doc, known, unit, dpi):
    """Coverage by ink (0 to 1) of a page, and the map from the file to its pixels."""
    import matplotlib

    matplotlib.use("Agg")
    from ezdxf.addons.drawing import Frontend, RenderContext, config
    from ezdxf.addons.drawing.matplotlib import MatplotlibBackend
    from matplotlib import pyplot

    wide, tall = (s / unit for s in known["sheet"])
    figure = pyplot.figure(figsize=(wide / 25.4, tall / 25.4), dpi=dpi)
    axis = figure.add_axes((0, 0, 1, 1))
    look = config.Configuration(
        background_policy=config.BackgroundPolicy.WHITE,
        color_policy=config.ColorPolicy.BLACK,
        lineweight_scaling=72 / 25.4,
        min_lineweight=0.2,
    )
    Frontend(RenderContext(doc), MatplotlibBackend(axis, adjust_figure=False), config=look).draw_layout(
        doc.modelspace(), finalize=False
    )
    axis.set_xlim(0, unit * wide)
    axis.set_ylim(0, unit * tall)
    axis.set_aspect("auto")
    # Otherwise lines along an axis are moved to whole pixels.
    for artist in axis.get_children():
        artist.set_snap(False)
    axis.axis("off")
    figure.canvas.draw()
    ink = 1.0 - numpy.asarray(figure.canvas.buffer_rgba())[..., 0].astype(numpy.float32) / 255.0
    pyplot.close(figure)
    step = dpi / 25.4 / unit
    # y up to rows down; pixels have their centres at whole numbers.
    page_from_file = numpy.array([[step, 0, -0.5], [0, -step, step * unit * tall - 0.5], [0, 0, 1]])
    return ink, page_from_file


def rotation(degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return numpy.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def shifted(x, y):
    return numpy.array([[1, 0, x], [0, 1, y], [0, 0, 1]])


def photo_from_page(traits, shape):
    """The homography of a tilted page, and the size of the photograph."""
    rows, columns = shape
    size = (PHOTO_WIDTH, 3 * PHOTO_WIDTH // 4)
    diagonal = math.hypot(rows, columns)
    tilt, towards = math.radians(traits["tilt_deg"]), traits["tilt_towards_deg"]
    # A point (x, y) of the page, turned about the axis y, is at x cos, y, distance + x sin.
    turned = numpy.array(
        [
            [math.cos(tilt), 0, 0],
            [0, 1, 0],
            [math.sin(tilt) / (traits["distance"] * diagonal), 0, 1],
        ]
    )
    made = rotation(traits["rotation_deg"] + towards) @ turned @ rotation(-towards)
    made = made @ shifted(-(columns - 1) / 2, -(rows - 1) / 2)
    corners = numpy.array([[x, y, 1] for x in (0, columns - 1) for y in (0, rows - 1)]).T
    at = made @ corners
    at = at[:2] / at[2]
    low, high = at.min(axis=1), at.max(axis=1)
    scale = traits["fill"] * min(size[k] / (high[k] - low[k]) for k in (0, 1))
    middle = (low + high) / 2
    place = shifted(size[0] / 2, size[1] / 2) @ numpy.diag([scale, scale, 1.0])
    return place @ shifted(-middle[0], -middle[1]) @ made, size


def warped(picture, target_from_source, size, outside):
    """Resamples a picture; larger ones are averaged first, so that thin lines do not vanish."""
    from scipy.ndimage import gaussian_filter, map_coordinates

    back = numpy.linalg.inv(target_from_source)
    steps = [numpy.arange(s, dtype=numpy.float32) for s in size]
    x, y = numpy.meshgrid(*steps)
    w = back[2, 0] * x + back[2, 1] * y + back[2, 2]
    at = [(back[k, 0] * x + back[k, 1] * y + back[k, 2]) / w for k in (1, 0)]
    middle = (size[0] // 2, size[1] // 2)
    shrink = abs(at[1][middle[1], middle[0] + 1] - at[1][middle[1], middle[0]])
    if shrink > 1.1:
        picture = gaussian_filter(picture, 0.4 * shrink)
    return map_coordinates(picture, at, order=1, cval=outside).astype(numpy.float32)


def background(size, dice):
    """A table with grain."""
    from scipy.ndimage import gaussian_filter

    grain = numpy.random.default_rng(dice.randrange(2**32)).normal(size=(size[1] // 4 + 1, size[0] // 4 + 1))
    grain = gaussian_filter(grain, (1, 20)).repeat(4, 0).repeat(4, 1)[: size[1], : size[0]]
    return (dice.uniform(0.2, 0.5) + 0.05 * grain / grain.std()).astype(numpy.float32)


def light(size, shade, dice):
    """Uneven light: a slope and a broad bump."""
    x, y = numpy.meshgrid(numpy.linspace(-1, 1, size[0]), numpy.linspace(-1, 1, size[1]))
    angle, at = dice.uniform(0, math.tau), (dice.uniform(-1, 1), dice.uniform(-1, 1))
    slope = 0.5 * (math.cos(angle) * x + math.sin(angle) * y)
    bump = numpy.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 0.3)
    return (1 - shade * (0.5 + slope - 0.5 * bump)).astype(numpy.float32)


def make_scan(doc, known, path, traits, dice, unit):
    """Writes the picture; returns its traits and the homography from the file to its pixels."""
    from PIL import Image
    from scipy.ndimage import gaussian_filter

    set_line_widths(doc, known["traits"]["language"], traits["thick_mm"])
    ink, page_from_file = rendered(doc, known, unit, traits["dpi"] or 300)
    rows, columns = ink.shape
    if traits["dpi"]:
        size = (columns, rows)
        middle = ((columns - 1) / 2, (rows - 1) / 2)
        change = shifted(*middle) @ rotation(traits["rotation_deg"]) @ shifted(-middle[0], -middle[1])
        paper = traits["paper"]
        around = paper
    else:
        change, size = photo_from_page(traits, ink.shape)
        around = None
    dark = warped(ink, change, size, 0.0)
    values = traits["paper"] + (traits["ink"] - traits["paper"]) * dark
    if around is None:
        is_page = warped(numpy.ones_like(ink), change, size, 0.0)
        values = is_page * values + (1 - is_page) * background(size, dice)
    values *= light(size, traits["shade"], dice)
    values = gaussian_filter(values, traits["blur_px"])
    noise = numpy.random.default_rng(dice.randrange(2**32)).normal(size=values.shape)
    values = 255 * values + traits["noise"] * noise
    picture = Image.fromarray(numpy.clip(values, 0, 255).round().astype(numpy.uint8))
    if traits["is_colour"]:
        picture = Image.merge("RGB", [picture, picture, picture.point(lambda v: round(0.93 * v))])
    picture.save(path.with_suffix(".jpg"), quality=traits["jpeg"])
    return {"scan": traits, "picture_from_file": (change @ page_from_file).tolist(), "size": list(size)}
