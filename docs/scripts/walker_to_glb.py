"""From a clip of meshes to a skinned .glb, in the cells of a notebook.

`# %%` begins a cell in Jupyter, VS Code, PyCharm and Spyder; it is a plain script, too. Run it
where `data_fixtures` is, as in a clone of the project: python docs/scripts/walker_to_glb.py
"""

# %% Load a clip, and the cage around its first frame.
import json
from pathlib import Path

import numpy as np

from cageik_cli import (
    Anchor,
    CageikError,
    Edit,
    Poser,
    Result,
    bind,
    build_report,
    check_cage,
    deform,
    edit_to_file,
    export,
    extract,
    extract_to_file,
    load_clip,
    load_mesh,
    point_at_vertex,
    read_cages,
    read_result,
    report_to_files,
)

walker = Path("data_fixtures/walker")
clip = load_clip(walker / "frames")
cage = load_mesh(walker / "cage.obj")
print(clip, cage)

# %% Check the cage, bind the model to it, and extract in memory.
diagnosis = check_cage(cage, clip.first)
assert diagnosis.is_fit
binding = bind(clip.first, cage)
animation = extract(clip, binding)
print(f"{animation.rms_percent:.2f} % of the diagonal; worst frame {animation.rms.argmax()}")

# %% Extract into a result file, with weights that are fitted to the clip.
output = Path("out")
output.mkdir(exist_ok=True)
result: Result | Edit = extract_to_file(
    walker / "frames", walker / "cage.obj", output / "walker.h5", fit=True, overwrite=True
)
cages = read_cages(result)
print(result, cages.shape)

# %% Report on it: a page, a plot, and figures for the pipeline.
report = build_report(result)
report_to_files(
    result,
    html=output / "walker.html",
    plot=output / "walker.png",
    csv=output / "walker.csv",
    overwrite=True,
)
print(report.verdict, f"{report.summary.rms_percent:.3f} %")

# %% Pose in memory: the left hand goes up, the right foot stays.
poser = Poser(
    binding,
    [
        Anchor("hand", point_at_vertex(clip.first, 1040)),
        Anchor("foot", point_at_vertex(clip.first, 994)),
    ],
)
posed = poser.solve_mesh(np.array([[0.1, 0.4, 0.2], [0.0, 0.0, 0.0]]))
print(f"moved by at most {np.abs(posed - clip.first.vertices).max():.2f}")

# %% Add the same to all frames, by a file of handles.
handles = {
    "handles": [
        {"name": "hand", "vertex": 1040, "offset": [0.1, 0.4, 0.2]},
        {"name": "foot", "vertex": 994, "pin": True},
    ]
}
(output / "handles.json").write_text(json.dumps(handles))
edit = edit_to_file(
    result, output / "handles.json", output / "waving.h5", rigidity=2, overwrite=True
)
assert read_result(output / "waving.h5").frames == edit.frames

# %% Write the edited clip for an engine: a skinned .glb, and the mesh itself.
written = export(edit, output / "waving.glb", skeleton=True, influences=4, overwrite=True)
mesh = deform(edit, output / "waving.npz", overwrite=True)
for summary in (written, mesh):
    print(summary.message, *map(str, summary.notes), sep="\n  ")

# %% An error is one sentence, which names the keyword.
try:
    export(edit, output / "waving.glb", skeleton=True, influences=4)
except CageikError as error:
    print(error)
