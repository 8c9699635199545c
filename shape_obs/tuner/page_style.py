"""How the page looks: two columns on a laptop, one on a phone, where the image stays in sight."""

from __future__ import annotations

from typing import Final

#: Properties of a row of buttons of which one is chosen.
TOGGLE: Final = "dense no-caps unelevated toggle-color=primary color=grey-3 text-color=grey-9"
STYLE: Final = """
body { background: #f3f5f8; }
.nicegui-content { padding: 0; }
.q-card { box-shadow: 0 1px 2px rgb(16 24 40 / 10%); border: 1px solid #e4e8ee; border-radius: 10px; }
.tune-body { display: grid; grid-template-columns: minmax(0, 1fr) 380px; grid-template-rows: auto 1fr; gap: 16px;
  grid-template-areas: "image controls" "views controls"; width: 100%; max-width: 1480px; margin: 0 auto;
  padding: 16px; align-items: start; }
.tune-left { grid-area: image; min-width: 0; }
.tune-right { grid-area: controls; }
.tune-below { grid-area: views; min-width: 0; }
.tune-toggle .q-btn { padding: 4px 12px; }
.q-tab { padding: 0 14px; }
.tune-title { font-weight: 600; color: #1f2a37; font-size: 15px; }
.tune-hint { color: #5b6776; font-size: 13px; line-height: 1.4; }
.tune-area img { touch-action: none; cursor: crosshair; }
.tune-pick img { cursor: crosshair; }
.tune-stage { border: 1px solid #e4e8ee; }
.tune-number input { text-align: right; padding: 0 !important; }
@media (max-width: 899px) {
  .tune-body { grid-template-columns: minmax(0, 1fr); grid-template-rows: none; gap: 10px; padding: 10px;
    grid-template-areas: "image" "controls" "views"; }
  .tune-left { position: sticky; top: 50px; z-index: 5; }
  .tune-image { padding: 8px; gap: 4px; }
  .tune-toggle .q-btn { padding: 4px 9px; }
  .q-tab { padding: 0 10px; min-height: 40px; }
  .tune-wide { display: none !important; }
}
"""
