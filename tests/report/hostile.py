"""Names that contain code, and factors that make models and cages degenerate."""

from dataclasses import replace

import numpy as np

from cageik_cli.util.messages import Note

NAMES = (
    "<script>window.struck = 1</script>.obj",
    "</script><script>window.struck = 1</script>",
    "</style></title><img src=x onerror='window.struck = 1'>",
    '" onmouseover="window.struck = 1" x="',
    "' onfocus='window.struck = 1' autofocus='",
    "line\nfeed\ttab\r\u2028\u202e{{ 7 * 7 }}{% raw %}<!--",
    "javascript:window.struck=1//&lt;&amp;",
)

FACTORS = {
    "flat": (np.array([1.0, 1, 0]), 1.0),
    "thin": (np.array([1e-12, 1, 0]), 1.0),
    "a point": (np.zeros(3), 1.0),
    "nothing but a point": (np.zeros(3), 0.0),
    "huge": (np.full(3, 1e30), 1e30),
    "tiny": (np.full(3, 1e-30), 1e-30),
    "a cage far away": (np.ones(3), 1e30),
    "a cage turned inside out": (np.ones(3), -0.3),
}


def with_hostile_names(report):
    """Replace all texts of a report by these names."""
    names = [NAMES[k % len(NAMES)] for k in range(len(report.frames))]
    frames = [replace(frame, name=name) for frame, name in zip(report.frames, names, strict=True)]
    frames[-1] = replace(
        frames[-1],
        **dict.fromkeys(
            ("rms", "rms_percent", "max_deviation", "max_deviation_percent", "worst_vertex")
        ),
        **dict.fromkeys(("volume", "volume_reconstructed", "volume_change", "volume_drift")),
        skipped=NAMES[1],
    )
    summary = replace(
        report.summary,
        worst_frame=NAMES[0],
        max_deviation_frame=NAMES[2],
        volume_change_frame=NAMES[3],
        worst_frame_index=0,
    )
    return replace(
        report,
        result=NAMES[1],
        tool={"name": "cageik", "version": NAMES[2]},
        sources={name: {"name": name, name: [name]} for name in NAMES},
        settings={name: name for name in NAMES},
        notes=tuple(map(Note, NAMES)),
        summary=summary,
        frames=tuple(frames),
        gates=tuple(replace(gate, frame=NAMES[0]) for gate in report.gates),
    )
