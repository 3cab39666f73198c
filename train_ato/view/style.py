"""Colours and themes of the page, dark; the quantities have the hues of the report."""

from pathlib import Path
from string import Template
from typing import Any

from train_ato.report.quantities import FONT, ORANGE, SKY
from train_ato.supervision.supervisor import SupervisionState

GROUND, PANE, EDGE = "#0a121c", "#101c29", "#24384b"
TEXT, SOFT, FAINT = "#e6edf3", "#8da2b5", "#1b2b3b"
NEEDLE = "#c3c3c3"
TRAIN, PROFILE, LIMIT, STOP = SKY, "#aebccb", "#ff5f45", "#ffd24a"
DEMAND, APPLIED = ORANGE, SKY
DRAFT, BUFF, SHOE = "#ff7a59", "#4aa3ff", "#d2a15c"
PERMITTED, WARNING, SERVICE, EMERGENCY = "#2dbd8e", "#ffd24a", "#e69f00", "#ff3b30"
UPHILL, DOWNHILL = "#8a6d3b", "#2f7f6d"
MARK = "#d79bd0"
_YELLOW, _ORANGE, _RED, _GREY = "#dfdf00", "#ea9100", "#e8202a", "#7d8790"
GAUGE_COLOURS: dict[SupervisionState, tuple[str, str, str]] = {
    SupervisionState.NORMAL: (_GREY, NEEDLE, _ORANGE),
    SupervisionState.INDICATION: (_YELLOW, _YELLOW, _ORANGE),
    SupervisionState.OVERSPEED: (_YELLOW, _ORANGE, _ORANGE),
    SupervisionState.WARNING: (_YELLOW, _ORANGE, _ORANGE),
    SupervisionState.SERVICE_BRAKE: (_YELLOW, _RED, _RED),
    SupervisionState.EMERGENCY_BRAKE: (_YELLOW, _RED, _RED),
}
"""Colours of gauge, needle and range above the permitted speed by state: ERA_ERTMS_015560, 8.2.1 (red lighter)."""

THEME: dict[str, Any] = {
    "attrs": {
        "Plot": {
            "background_fill_color": PANE, "border_fill_color": PANE, "outline_line_color": EDGE,
            "outline_line_alpha": 1.0, "min_border_left": 58, "min_border_right": 14, "min_border_top": 4,
            "min_border_bottom": 4,
        },
        "Grid": {"grid_line_color": FAINT, "grid_line_width": 1},
        "Axis": {
            "major_label_text_color": SOFT, "major_label_text_font": FONT, "major_label_text_font_size": "11px",
            "axis_label_text_color": SOFT, "axis_label_text_font": FONT, "axis_label_text_font_size": "11px",
            "axis_label_text_font_style": "normal", "axis_label_standoff": 6, "axis_line_color": EDGE,
            "major_tick_line_color": EDGE, "minor_tick_line_color": None, "major_tick_in": 0, "major_tick_out": 4,
        },
        "Text": {"text_font": {"value": FONT}, "text_color": {"value": TEXT}},
    }
}  # fmt: skip
"""Bokeh theme of every figure on the page."""

_COLOURS = {"EDGE": EDGE, "FONT": FONT, "GROUND": GROUND, "SKY": SKY, "SOFT": SOFT, "TEXT": TEXT}
WIDGETS = Template(Path(__file__).with_name("page.widgets.css").read_text(encoding="utf-8")).substitute(_COLOURS)
"""Style sheet of the widgets; each widget has its own shadow root."""
