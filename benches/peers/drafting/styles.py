"""Traits of a sheet, and the names of layers and line types in several languages."""

import dataclasses

# The first value of each trait is the simplest one; the numbers are relative frequencies.
TRAITS = {
    "projection": {"first": 1, "third": 1},
    "views": {"3": 6, "2": 1},
    "side": {"right": 1, "left": 1},
    "scale": {"1:1": 2, "1:2": 1, "2:1": 1},
    "scale-mark": {"dimlfac": 2, "title": 1, "frame": 1},
    "language": {"en": 1, "iso": 1, "de": 1, "fr": 1, "plain": 1},
    "style-by": {"layer": 2, "entity": 1, "entity-on-0": 1},
    "blocks": {"no": 2, "views": 1, "scaled": 1},
    "dimensions": {"none": 1, "true": 2, "exploded": 1},
    "frame": {"no": 1, "yes": 3, "block": 1},
    "centre": {"no": 1, "yes": 3},
    "notes": {"no": 1, "yes": 2},
    "hidden": {"yes": 6, "no": 1},
    "section": {"no": 5, "extra": 1, "replace-side": 1, "replace-front": 1},
    "corner": {"no": 4, "iso": 1, "detail": 1},
    "decimals": {"full": 1, "4": 2},
    "misaligned": {"no": 2, "yes": 1},
    "turned": {"no": 11, "yes": 1},
    "smooth": {"no": 4, "yes": 1},
    "version": {"R2000": 1, "R2010": 1, "R2018": 1},
}

EXPLANATIONS = {
    "projection": "first or third angle",
    "views": "number of views",
    "side": "the side from which the third view is seen",
    "scale": "scale of the drawing",
    "scale-mark": "dimlfac: lengths are those of the paper, and DIMLFAC is set; title: the title block alone "
    "states the scale, and dimensions have fixed texts; frame: lengths are true, and the frame is scaled",
    "language": "names of layers and line types; plain: names without a meaning, only the dashes differ",
    "style-by": "line types by layer, by entity, or by entity with all lines on layer 0",
    "blocks": "views as blocks, or as blocks of true size that are scaled when inserted",
    "dimensions": "DIMENSION entities, or their lines, arrows and texts",
    "frame": "frame with zones, title block and projection symbol; as lines or as a block with attributes",
    "centre": "centre lines and centre marks",
    "notes": "notes, leaders, surface symbols, view names",
    "hidden": "hidden lines",
    "section": "a hatched section beside the views or instead of one",
    "corner": "an isometric view or an enlarged detail",
    "decimals": "decimals of the coordinates",
    "misaligned": "views displaced by up to 0.02 mm",
    "turned": "the part is turned by a fraction of a degree",
    "smooth": "smooth edges are drawn",
    "version": "version of the DXF file",
}

DASHED, CHAIN = [9.0, 6.0, -3.0], [28.0, 20.0, -3.0, 2.0, -3.0]
ISO_DASHED, ISO_CHAIN = [15.0, 12.0, -3.0], [30.0, 24.0, -3.0, 0.5, -2.5]
DOTTED_CHAIN = [18.0, 12.0, -3.0, 0.0, -3.0]


@dataclasses.dataclass
class Language:
    """Layer names by role, and the line types to choose from: (name, description, pattern)."""

    layers: dict
    hidden: list
    centre: list
    words: dict


def roles(text):
    keys = ["visible", "hidden", "centre", "dimension", "text", "frame", "hatch", "section", "thin"]
    return dict(zip(keys, text.split()))


ENGLISH = {
    "title": "Title",
    "scale": "Scale",
    "material": "Material",
    "date": "Date",
    "drawn": "Drawn",
    "tolerance": "General tolerances ISO 2768-mK",
    "note": "All edges without burrs.\\PDimensions in mm.",
    "front": "FRONT",
    "top": "TOP",
    "right": "RIGHT",
    "left": "LEFT",
    "deep": "deep",
}
GERMAN = {
    "title": "Benennung",
    "scale": "Maßstab",
    "material": "Werkstoff",
    "date": "Datum",
    "drawn": "Bearb.",
    "tolerance": "Allgemeintoleranzen ISO 2768-mK",
    "note": "Alle Kanten gratfrei.\\PMaße in mm.",
    "front": "Vorderansicht",
    "top": "Draufsicht",
    "right": "Ansicht von rechts",
    "left": "Ansicht von links",
    "deep": "tief",
}
FRENCH = {
    "title": "Titre",
    "scale": "Echelle",
    "material": "Matière",
    "date": "Date",
    "drawn": "Dessiné",
    "tolerance": "Tolérances générales ISO 2768-mK",
    "note": "Arêtes ébavurées.\\PCotes en mm.",
    "front": "Vue de face",
    "top": "Vue de dessus",
    "right": "Vue de droite",
    "left": "Vue de gauche",
    "deep": "prof.",
}

LANGUAGES = {
    "en": Language(
        roles("VISIBLE HIDDEN CENTER DIMENSIONS TEXT BORDER HATCH SECTION THIN"),
        [
            ("HIDDEN", "Hidden __ __ __", DASHED),
            ("DASHED", "Dashed __ __", DASHED),
            ("HIDDEN2", "Hidden (.5x)", DASHED),
        ],
        [("CENTER", "Center ____ _ ____", CHAIN), ("CENTER2", "Center (.5x)", CHAIN)],
        ENGLISH,
    ),
    "iso": Language(
        roles("Outline Edges_2 Axes Dim Annotation Sheet Fill Cut Narrow"),
        [
            ("ACAD_ISO02W100", "ISO dash __ __ __", ISO_DASHED),
            ("ACAD_ISO03W100", "ISO dash space __    __", [30.0, 12.0, -18.0]),
        ],
        [
            ("ACAD_ISO10W100", "ISO dash dot __ . __", DOTTED_CHAIN),
            ("ACAD_ISO08W100", "ISO long-dash short-dash", CHAIN),
        ],
        ENGLISH,
    ),
    "de": Language(
        roles("Kontur Verdeckt Mittellinie Bemaßung Text Rahmen Schraffur Schnittlinie Schmal"),
        [("VERDECKT", "Verdeckt __ __ __", DASHED), ("GESTRICHELT", "Gestrichelt __ __", DASHED)],
        [("STRICHPUNKT", "Strichpunkt __ . __", DOTTED_CHAIN), ("MITTE", "Mitte ____ _ ____", CHAIN)],
        GERMAN,
    ),
    "fr": Language(
        roles("Contour Caché Axes Cotes Texte Cadre Hachures Coupe Fin"),
        [("CACHE", "Caché __ __ __", DASHED), ("INTERROMPU", "Interrompu __ __", DASHED)],
        [("AXES", "Axes ____ _ ____", CHAIN), ("MIXTE", "Mixte __ . __", DOTTED_CHAIN)],
        FRENCH,
    ),
    "plain": Language(
        roles("AM_0 AM_3 AM_7 AM_5 AM_6 AM_BOR AM_8 AM_10 AM_4"),
        [("LT2", "", DASHED), ("L07", "", ISO_DASHED)],
        [("LT4", "", CHAIN), ("L09", "", DOTTED_CHAIN)],
        ENGLISH,
    ),
}


def choose(dice, fixed, simple=False):
    """A value of each trait; `fixed` has those that are given."""
    chosen = {}
    for name, values in TRAITS.items():
        drawn = dice.choices(list(values), list(values.values()))[0]
        chosen[name] = fixed.get(name) or (next(iter(values)) if simple else drawn)
    return chosen
