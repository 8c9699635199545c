"""A net for changes: short streams of frames, and what the detector makes of them.

``data/NAME.npz`` holds what a detector is given (masks, depth, pictures or clouds, stamps, anchors, the camera and the
detector's arguments) and the truth that the scene was drawn from. ``expected/NAME.npz`` holds the detections of the
code that was accepted last: points, flags, reasons, tracks, sigma. ``catalogue`` lists streams that were chosen one by
one, and ``varied`` draws a table in which bodies, motions, frame rates, gaps, lenses and questions meet by chance.

    uv run python -m tests.golden.judge                  # all streams: same or not, error against the truth, time
    uv run python -m tests.golden.judge 'sheet_*' --json
    uv run python -m tests.golden.make rope_calm         # accept today's detections of a stream
    uv run python -m tests.golden.make rope_new --draw   # draw the frames of a stream, too

Hold a change against the truth first, and against the expected points second. Accept detections only in a commit whose
message has the table that ``make`` prints: the errors before and after.
"""
