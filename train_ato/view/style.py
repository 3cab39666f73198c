"""Colours and themes of the page, dark; the quantities have the hues of the report."""

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

WIDGETS = f"""
:host {{ color: {TEXT}; font-family: {FONT}; }}
label, .bk-slider-title {{ color: {SOFT}; font-size: 12px; }}
.bk-slider-title .bk-slider-value, .bk-slider-value {{ color: {TEXT}; }}
.bk-input {{ background-color: {GROUND}; color: {TEXT}; border: 1px solid {EDGE}; border-radius: 4px; min-height: 26px;
  padding: 0 8px; font-size: 12px; }}
.bk-input:focus {{ border-color: {SKY}; box-shadow: none; }}
.bk-input[disabled] {{ background-color: #142230; color: #5b6f82; border-color: #24384b; opacity: 1; }}
select.bk-input {{ background-image: none; }}
select.bk-input option {{ background: {GROUND}; color: {TEXT}; padding: 3px 2px; }}
.bk-btn {{ background: #1a2c3d; color: {TEXT}; border: 1px solid #34506a; border-radius: 4px; font-size: 12px;
  font-weight: 600; text-shadow: none; }}
.bk-btn:hover {{ background: #22394f; border-color: {SKY}; color: #fff; }}
.bk-btn.bk-active {{ background: {SKY}; color: #06121d; border-color: {SKY}; box-shadow: none; }}
.bk-btn[disabled], .bk-btn[disabled]:hover {{ background: #142230; color: #5b6f82; border-color: #24384b; opacity: 1; }}
.bk-btn-danger {{ background: #b3181b; border-color: #ff6a63; color: #fff; font-size: 14px; letter-spacing: .04em; }}
.bk-btn-danger:hover {{ background: #d92226; }}
.bk-btn-warning {{ background: #7a5a12; border-color: #d6a72f; color: #fff; font-size: 14px; }}
.noUi-target {{ background: #1f3244; border: none; box-shadow: none; height: 6px; }}
.noUi-connect {{ background: {SKY}; }}
.noUi-handle {{ background: {TEXT}; border: none; box-shadow: 0 0 2px #000; }}
.noUi-handle::before, .noUi-handle::after {{ display: none; }}
.bk-switch {{ filter: none; }}
"""
"""Style sheet of the widgets; each widget has its own shadow root."""
