"""Writes the sheets of `sheets.py` as PDF files, as different programs write them, for `sheet_solids.py`.

- `matplotlib`: by ezdxf; the sheet fills the page, texts are filled outlines, dashes are single lines.
- `pymupdf`: by ezdxf in true size; texts and dashes as above, numbers with few decimals.
- `reportlab`: in true size with texts, dash patterns and Bézier curves; content in ASCII85.
- `cairo`: as reportlab; coordinates are multiples of 1/256 pt.

Needs ezdxf and the libraries of the writers (matplotlib, pymupdf, reportlab, cairocffi).

    python benches/peers/sheet_pdfs.py FOLDER --writer reportlab
    python benches/peers/sheet_solids.py target/release/planish FOLDER --ending .pdf
"""

import argparse
import math
import pathlib

import ezdxf
from drafting.sheet import save_pictures
from ezdxf.addons.drawing import Frontend, RenderContext, config, layout
from ezdxf.addons.drawing.backend import Backend
from ezdxf.path import Command

POINT = 72 / 25.4
MARGIN = 10.0


class Page:
    """A page in millimetres; what each library calls differently is a method."""

    def __init__(self, path, low, high):
        self.path, self.low, self.size = path, low, [high[k] - low[k] + 2 * MARGIN for k in (0, 1)]

    def at(self, p):
        return tuple((p[k] - self.low[k] + MARGIN) * POINT for k in (0, 1))


class ReportLab(Page):
    def begin(self):
        from reportlab.pdfgen.canvas import Canvas

        self.canvas = Canvas(str(self.path), pagesize=[s * POINT for s in self.size], invariant=1)

    def path_of(self, commands):
        made, verbs = self.canvas.beginPath(), {"m": "moveTo", "l": "lineTo", "c": "curveTo"}
        for verb, points in commands:
            getattr(made, verbs[verb])(*(c for p in points for c in self.at(p)))
        return made

    def stroke(self, commands, width, dashes, color):
        self.canvas.setStrokeColorRGB(*color)
        self.canvas.setLineWidth(width * POINT)
        self.canvas.setDash([d * POINT for d in dashes])
        self.canvas.drawPath(self.path_of(commands), stroke=1, fill=0)

    def fill(self, commands):
        self.canvas.drawPath(self.path_of(commands), stroke=0, fill=1)

    def text(self, p, words, height, angle):
        self.canvas.saveState()
        self.canvas.translate(*self.at(p))
        self.canvas.rotate(angle)
        self.canvas.setFont("Helvetica", height * 1.4 * POINT)
        self.canvas.drawString(0, 0, words)
        self.canvas.restoreState()

    def end(self):
        self.canvas.save()


class Cairo(Page):
    def begin(self):
        import cairocffi

        self.surface = cairocffi.PDFSurface(str(self.path), *(s * POINT for s in self.size))
        self.context = cairocffi.Context(self.surface)
        # Its y points down.
        self.context.translate(0, self.size[1] * POINT)
        self.context.scale(1, -1)

    def path_of(self, commands):
        verbs = {"m": "move_to", "l": "line_to", "c": "curve_to"}
        for verb, points in commands:
            getattr(self.context, verbs[verb])(*(c for p in points for c in self.at(p)))

    def stroke(self, commands, width, dashes, color):
        self.path_of(commands)
        self.context.set_source_rgb(*color)
        self.context.set_line_width(width * POINT)
        self.context.set_dash([d * POINT for d in dashes])
        self.context.stroke()

    def fill(self, commands):
        self.path_of(commands)
        self.context.fill()

    def text(self, p, words, height, angle):
        self.context.save()
        self.context.translate(*self.at(p))
        self.context.rotate(math.radians(angle))
        self.context.scale(1, -1)
        self.context.set_font_size(height * 1.4 * POINT)
        self.context.move_to(0, 0)
        self.context.show_text(words)
        self.context.restore()

    def end(self):
        self.surface.finish()


class Plotter(Backend):
    """Passes lines, curves, fills and texts of ezdxf to a page."""

    def __init__(self, page):
        super().__init__()
        self.page, self.dashes, self.is_dimension = page, [], False

    def enter_entity(self, entity, properties):
        super().enter_entity(entity, properties)
        self.is_dimension = self.is_dimension or entity.dxftype() == "DIMENSION"
        dashes = [abs(d) for d in getattr(properties, "linetype_pattern", ())]
        # A last gap may be missing.
        self.dashes = dashes[: len(dashes) // 2 * 2]

    def exit_entity(self, entity):
        super().exit_entity(entity)
        if entity.dxftype() == "DIMENSION":
            self.is_dimension = False

    def stroke(self, commands, properties):
        color = [c / 255 for c in properties.rgb]
        width = 0.5 if sum(color) == 0 and not self.is_dimension else 0.25
        self.page.stroke(commands, width, self.dashes, color)

    def draw_point(self, pos, properties):
        pass

    def draw_line(self, start, end, properties):
        self.stroke([("m", [start]), ("l", [end])], properties)

    def draw_solid_lines(self, lines, properties):
        for start, end in lines:
            self.stroke([("m", [start]), ("l", [end])], properties)

    def commands(self, path):
        yield "m", [path.start]
        at = path.start
        for command in path.commands():
            if command.type == Command.CURVE3_TO:
                a, b = command.ctrl, command.end
                yield "c", [at + (a - at) * (2 / 3), b + (a - b) * (2 / 3), b]
            elif command.type == Command.CURVE4_TO:
                yield "c", [command.ctrl1, command.ctrl2, command.end]
            else:
                yield "m" if command.type == Command.MOVE_TO else "l", [command.end]
            at = command.end

    def draw_path(self, path, properties):
        self.stroke(list(self.commands(path)), properties)

    def draw_filled_paths(self, paths, properties):
        self.page.fill([c for path in paths for c in self.commands(path)])

    def draw_filled_polygon(self, points, properties):
        first, *others = points.vertices()
        self.page.fill([("m", [first]), *(("l", [p]) for p in others)])

    def draw_image(self, image_data, properties):
        pass

    def set_background(self, color):
        pass

    def clear(self):
        pass


class WithTexts(Frontend):
    """Draws texts as texts, not as outlines."""

    def draw_text_entity(self, entity, properties):
        if entity.dxftype() == "MTEXT":
            words, height = entity.plain_text(), entity.dxf.char_height
            angle, place = entity.get_rotation(), entity.dxf.insert
        else:
            words, height = entity.plain_text(), entity.dxf.height
            angle, place = entity.dxf.rotation, entity.get_placement()[1]
        for k, line in enumerate(words.split("\n")):
            self.page.text((place.x, place.y - 1.5 * k * height), line, height, angle)

    draw_mtext_entity = draw_text_entity


def native(doc, path, page_type):
    from ezdxf import bbox

    box = bbox.extents(doc.modelspace(), fast=True)
    page = page_type(path, box.extmin, box.extmax)
    page.begin()
    white = config.BackgroundPolicy.WHITE
    settings = config.Configuration(line_policy=config.LinePolicy.SOLID, background_policy=white)
    frontend = WithTexts(RenderContext(doc), Plotter(page), config=settings)
    frontend.page = page
    frontend.draw_layout(doc.modelspace())
    page.end()


def by_pymupdf(doc, path):
    from ezdxf import bbox
    from ezdxf.addons.drawing import pymupdf

    backend = pymupdf.PyMuPdfBackend()
    settings = config.Configuration(background_policy=config.BackgroundPolicy.WHITE)
    Frontend(RenderContext(doc), backend, config=settings).draw_layout(doc.modelspace())
    # ezdxf rounds the page to whole points and distorts the drawing if it has other sides.
    size = bbox.extents(doc.modelspace(), fast=True).size
    sides = [(math.ceil((size[k] + 2 * MARGIN) * POINT) + 1e-3) / POINT for k in (0, 1)]
    page = layout.Page(*sides, layout.Units.mm, layout.Margins.all(0))
    path.write_bytes(backend.get_pdf_bytes(page, settings=layout.Settings(scale=1.0, fit_page=False)))


def write(doc, path, writer):
    if writer == "matplotlib":
        save_pictures(doc, path.with_suffix(""), ["pdf"])
    elif writer == "pymupdf":
        by_pymupdf(doc, path)
    else:
        native(doc, path, {"reportlab": ReportLab, "cairo": Cairo}[writer])


def main():
    reading = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    reading.add_argument("folder", type=pathlib.Path)
    reading.add_argument("--writer", choices=("matplotlib", "pymupdf", "reportlab", "cairo"), required=True)
    asked = reading.parse_args()
    for drawing in sorted(asked.folder.glob("*.dxf")):
        write(ezdxf.readfile(drawing), drawing.with_suffix(".pdf"), asked.writer)
        print(drawing.stem, flush=True)


main()
