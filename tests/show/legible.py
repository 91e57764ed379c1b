"""What a reader would object to in a figure: text over text, text over a curve, text that is cut off."""

from itertools import combinations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

ROOM = 1.0
"""Pixels by which boxes may touch."""
CLOSE = 1.0
"""Distance of the points along a curve that are looked at [pixels]."""


def faults(figure: Figure) -> list[str]:
    """Every fault in words."""
    if figure.stale:  # it is not drawn yet
        figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    hidden = _hidden(figure)
    shown = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    boxes = {text: text.get_window_extent(renderer) for text in shown if text not in hidden}
    boxes = {text: box for text, box in boxes.items() if box.width > 0}
    found = [f"{text.get_text()!r} is cut off" for text, box in boxes.items() if not _inside(box, figure.bbox)]
    for one, other in combinations(boxes, 2):
        if _smaller(boxes[one]).overlaps(_smaller(boxes[other])):
            found.append(f"{one.get_text()!r} lies over {other.get_text()!r}")
    for axes in figure.axes:
        own = [text for text in axes.texts if text in boxes and text.get_bbox_patch() is None]
        for line in axes.lines if own else ():
            if line.get_linestyle() == "None" or not line.get_visible():
                continue
            places = _along(line.get_transform().transform(line.get_xydata()))
            covered = (text for text in own if _covers(_smaller(boxes[text]), places))
            found += [f"{text.get_text()!r} lies over a curve" for text in covered]
    return found


def _hidden(figure: Figure) -> set[Text]:
    """Labels of ticks outside of the view, which Matplotlib does not draw, and labels of axes without an axis."""
    hidden = set[Text]()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            room = 1e-9 * (high - low)
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if not axes.axison or not low - room <= tick.get_loc() <= high + room:
                    hidden |= {tick.label1, tick.label2}
            if not axes.axison:
                hidden |= {axis.label, axis.offsetText}
    return hidden


def _inside(box: Bbox, outer: Bbox) -> bool:
    return bool(
        box.x0 >= outer.x0 - ROOM
        and box.x1 <= outer.x1 + ROOM
        and box.y0 >= outer.y0 - ROOM
        and box.y1 <= outer.y1 + ROOM
    )


def _smaller(box: Bbox) -> Bbox:
    return Bbox.from_extents(box.x0 + ROOM, box.y0 + ROOM, box.x1 - ROOM, box.y1 - ROOM)


def _along(places: np.ndarray) -> np.ndarray:
    places = places[np.isfinite(places).all(axis=1)]
    if len(places) < 2:
        return places
    lengths = np.append(0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T)))
    evenly = np.linspace(0, lengths[-1], 2 + int(lengths[-1] / CLOSE))
    return np.column_stack([np.interp(evenly, lengths, column) for column in places.T])


def _covers(box: Bbox, places: np.ndarray) -> bool:
    return bool(np.any(np.all((places > box.min) & (places < box.max), axis=1)))
