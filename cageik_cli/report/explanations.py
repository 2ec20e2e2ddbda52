"""What the words of a page mean."""

METRICS = {
    "rms": "error of the clip",
    "frame_rms": "error of the worst frame",
    "max_deviation": "max deviation",
    "volume_change": "volume change",
}
"""What limits are on."""

SETTINGS = {
    "accuracy": "how near harmonic weights are to exact ones",
    "align": "each frame is moved rigidly onto the rest pose before it is solved",
    "alpha": "weight of the cage's Laplacian",
    "beta": "weight of the vertices",
    "coordinates": "what the weights are",
    "outside": "what is done with vertices outside the cage",
    "rest_frame": "the frame that is the rest pose; none if it is a file of its own",
    "vertex_weights": "whether vertices were weighed one by one",
}

MEANINGS = (
    (
        "Error of a frame, RMS",
        "rms = √( mean |v̂ − v|² )",
        "The mean is over the vertices, less those of weight 0. In units of the file, or as "
        "percent of the diagonal: 100 rms / D.",
    ),
    (
        "Error of the clip",
        "√( mean rms² )",
        "The mean is over the frames that were not skipped. The headline. From 0.3 to 1 % is usual "
        "for a body in a cage of about 100 vertices; a finer cage lowers it.",
    ),
    (
        "RMS of a vertex",
        "√( mean |v̂ − v|² )",
        "The mean is over the frames. The histogram counts vertices by it, and the model is "
        "coloured by it: where it is high, the cage is too coarse, or the model moves in ways a "
        "cage cannot follow.",
    ),
    (
        "Max deviation",
        "max |v̂ − v|",
        "Over the vertices of a frame, or over all frames; with the vertex where it is.",
    ),
    (
        "Volume change",
        "100 (V̂ − V) / V",
        "What the reconstruction gains or loses against its own frame, in percent; signed. Of the "
        "clip, the change of largest size. Not defined for open models, or where vertices are "
        "missing data.",
    ),
    (
        "Drift from rest",
        "100 (V − V_rest) / V_rest",
        "What the input itself gains or loses against the rest pose, in percent; no fault of the "
        "cage.",
    ),
    (
        "E_RMS",
        "2000/√3 · rms / D = 1154.70 rms / D",
        "The error of the clip as Kavan, Sloan and O'Sullivan (2010) state it.",
    ),
    (
        "KG error",
        "100 |V − V̂| / |V − E(V)|",
        "The error against the spread of each frame about its centroid E(V), V being all "
        "coordinates of the clip (Karni and Gotsman 2004), in percent.",
    ),
    (
        "Size",
        "",
        "A cage has three numbers a vertex in each frame; the weights, one for each vertex of the "
        "model and of the cage, are kept once.",
    ),
    (
        "Verdict",
        "",
        "A figure is compared with its limit as it is printed here. Over a limit, the command ends "
        "with exit code 3.",
    ),
    (
        "Worst, median and best frame",
        "",
        "By the rms of the frame. Vertices are coloured by |v̂ − v|, all poses on one scale.",
    ),
)
"""Term, formula, and what it says."""
