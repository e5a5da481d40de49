"""Scores of the finished program: `python -m densecloud_training.score COMMAND ...`.

Everything is computed by the `densecloud` program itself (`sample`, `evaluate`, `upsample`, `render`), so what is
scored is what users run: weights, merging and all. Files made on the way are kept in the `--out` folder and used again.

    program     the program: its commands, and results that are kept
    report      scores read from `densecloud evaluate --json`, and their means
    table       tables in Markdown
    inputs      clouds sampled from meshes, and clouds with holes
    validation  held-out shapes, beside the controls
    stress      curves over noise and over removed points
    rules       the cascade's own rules, each changed alone
    thin        where a shape is thin or nearly touches itself, against the rest
    sheets      how near another sheet of a mesh lies
    tiled       the same clouds in one piece and in tiles
    peers       the PU-GAN benchmark, beside other networks
    real        real scans, thinned and upsampled back, beside the controls
    scans       readers of scan files, and views that show them well
    pictures    before and after, of real scans
    cleaning    what to do with a noisy scan before upsampling
    noisy       what that gains, measured
    splats      what denser seeds gain Gaussian splatting
"""
