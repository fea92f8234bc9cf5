#!/usr/bin/env python3
r"""Draws what a terminal shows as an SVG: the first argument is the prompt line, standard input the output.

tirante replay recordings/campaign-2025.mcap --config config/campaign.toml --store campaign.db 2>/dev/null |
    sed -n '1,7p;7a ...
            /2025-06-20/,/tirante ack/p' |
    python3 docs/images/terminal_svg.py 'tirante replay recordings/campaign-2025.mcap --config config/campaign.toml --store campaign.db' \
    > docs/images/replay.svg
"""
import sys
from xml.sax.saxutils import escape

STEP, LEADING, MARGIN = 7.8, 19, 16
prompt = sys.argv[1]
lines = [line.rstrip("\n") for line in sys.stdin]
columns = max(len(line) for line in [*lines, "$ " + prompt])
width = columns * STEP + 2 * MARGIN
height = (len(lines) + 1) * LEADING + 2 * MARGIN


def text(row, content, colour):
    # Browsers run spaces together.
    solid = content.replace(" ", "\u00a0")
    y = MARGIN + LEADING * row + 14
    # A fixed length keeps the columns aligned whatever monospace font stands in.
    length = f' textLength="{len(content) * STEP:.1f}"' if content else ""
    return f'<text x="{MARGIN}" y="{y}" fill="{colour}"{length} lengthAdjust="spacingAndGlyphs">{escape(solid)}</text>'


print(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height}" font-size="13" '
      'font-family="ui-monospace, DejaVu Sans Mono, Menlo, Consolas, monospace" xml:space="preserve">')
print(f'<rect width="{width:.0f}" height="{height}" rx="8" fill="#1e2329"/>')
print(text(0, "$ " + prompt, "#8fc7ff"))
is_alarm = False
for row, line in enumerate(lines, 1):
    # As on a terminal: the words of an alarm, and the rows of a rod in alarm.
    is_alarm = line.startswith(">>>") or is_alarm and line.startswith("    ") and not line.startswith("    stands until")
    is_red = is_alarm or line.endswith("  alarm")
    print(text(row, line, "#ff8a80" if is_red else "#8a949e" if set(line) <= {"-", "."} else "#e6e6e6"))
print("</svg>")
