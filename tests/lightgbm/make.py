"""Writes model.txt, which PyPI's lightgbm trains on bytes made here, and rows.csv: per row lightgbm's raw score, the leaf of
each tree, then the features as NUMBER=VALUE; those that are left out are 0.

    pip install lightgbm==4.7.0 && python3 make.py
"""

import pathlib

import lightgbm
import numpy

FEATURES, USED, ROWS = 1600, 12, 40
HERE = pathlib.Path(__file__).resolve().parent

random = numpy.random.default_rng(1)
used = sorted(random.choice(FEATURES, USED, replace=False))
values = numpy.zeros((3000, FEATURES), numpy.uint8)
values[:, used] = random.integers(0, 256, (3000, USED))
signal = values[:, used].astype(float) @ random.normal(size=USED)
labels = (signal > numpy.median(signal)).astype(int)
options = {"objective": "binary", "max_depth": 5, "num_leaves": 20, "learning_rate": 0.2, "verbose": -1, "seed": 1,
           "num_threads": 1, "deterministic": True}
model = lightgbm.train(options, lightgbm.Dataset(values, labels), num_boost_round=8)
# The parameters behind the trees are of no use here.
text = model.model_to_string().split("\nend of trees")[0] + "\nend of trees\n"
lines = [line for line in text.splitlines() if not line.startswith(("feature_names=", "feature_infos="))]
(HERE / "model.txt").write_text("\n".join(lines) + "\n")
edge = [tree.split("threshold=")[1].split("\n")[0].split() for tree in text.split("Tree=")[1:]]
rows = values[:ROWS].copy()
# Rows at the thresholds: a byte at each side of one.
limits = [float(value) for thresholds in edge for value in thresholds]
for number in range(ROWS // 2):
    rows[number, used] = [int(limits[(number * USED + i) % len(limits)]) + number % 2 for i in range(USED)]
scores, leaves = model.predict(rows, raw_score=True), model.predict(rows, pred_leaf=True)
with open(HERE / "rows.csv", "w", encoding="utf-8") as file:
    for row, score, own in zip(rows, scores, leaves):
        features = [f"{feature}={row[feature]}" for feature in used]
        print(repr(float(score)), *own.astype(int), *features, sep=",", file=file)
