"""Labels and detections of small data sets, read again by pycocotools and motmetrics: tests/readers/read.py LOOKOUT"""

import json
import random
import subprocess
import sys
import tempfile
from pathlib import Path

import motmetrics
import numpy
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

LOOKOUT = sys.argv[1]
FRAMES = 60


def lookout(*args):
    done = subprocess.run([LOOKOUT, *map(str, args)], capture_output=True, text=True)
    assert done.returncode == 0, f"{args}: {done.stderr}"
    return done.stdout


def picture(path):
    """A grey picture of 64 x 48 (PGM)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"P5 64 48 255\n" + bytes(64 * 48))


def mot_tree(folder, seed):
    """A MOTChallenge sequence of two objects, and its rows."""
    dice = random.Random(seed)
    rows = []
    for frame in range(1, FRAMES + 1):
        picture(folder / "img1" / f"{frame:06}.pgm")
        for number in (1, 2):
            if dice.random() < 0.9:
                left, top = dice.uniform(0, 40), dice.uniform(0, 30)
                width, height = dice.uniform(9, 20), dice.uniform(9, 15)
                rows.append((frame, number, *(round(v, 2) for v in (left, top, width, height))))
    text = "".join(",".join(map(str, row)) + ",1,1,1\n" for row in rows)
    (folder / "gt").mkdir(parents=True)
    (folder / "gt" / "gt.txt").write_text(text)
    (folder / "seqinfo.ini").write_text(
        f"[Sequence]\nname={folder.name}\nimDir=img1\nframeRate=20\nseqLength={FRAMES}\nimWidth=64\nimHeight=48\nimExt=.pgm\n"
    )
    return rows


def same_tracks(gt, rows):
    """motmetrics reads the labels and finds every object where it was, without a switch."""
    read = motmetrics.io.loadtxt(gt, fmt="mot15-2D")
    truth = motmetrics.MOTAccumulator(auto_id=True)
    for frame in range(1, FRAMES + 1):
        own = [row for row in rows if row[0] == frame]
        here = read.loc[[frame]] if frame in read.index.get_level_values(0) else read.iloc[:0]
        boxes = here[["X", "Y", "Width", "Height"]].to_numpy()
        # motmetrics takes one from the corners: MATLAB counts pixels from 1.
        boxes = boxes + [1, 1, 0, 0]
        distances = motmetrics.distances.iou_matrix([row[2:] for row in own], boxes, max_iou=0.01)
        truth.update([row[1] for row in own], list(here.index.get_level_values(1)), distances)
    figures = motmetrics.metrics.create().compute(
        truth, metrics=["num_matches", "num_misses", "num_false_positives", "num_switches"]
    )
    matches, others = figures.iloc[0, 0], figures.iloc[0, 1:].sum()
    assert matches == len(rows) and others == 0, figures
    return len(rows)


def detections(rows, seed):
    """Most objects found, some of them badly, and false alarms."""
    dice = random.Random(seed)
    lines = []
    for frame, _, left, top, width, height in rows:
        if dice.random() < 0.8:
            shift = dice.choice([0.0, 0.5, 4.0])
            score = dice.uniform(-1, 5)
            lines.append((frame, left + shift, top, width, height, score))
        if dice.random() < 0.3:
            lines.append((frame, dice.uniform(0, 50), dice.uniform(0, 35), 12, 10, dice.uniform(-4, 3)))
    return "".join(f"{f},-1,{l:.4f},{t:.4f},{w},{h},{s:.6f}\n" for f, l, t, w, h, s in lines)


def coco_figures(folder):
    """pycocotools' average precision at IoU 0.5, by all points instead of 101."""
    truth = COCO(str(folder / "ground_truth.json"))
    found = truth.loadRes(str(folder / "detections.json"))
    judged = COCOeval(truth, found, "bbox")
    judged.params.iouThrs = numpy.array([0.5])
    judged.params.recThrs = numpy.linspace(0, 1, 100001)
    judged.params.areaRng, judged.params.areaRngLbl = [[0, 1e10]], ["all"]
    judged.params.maxDets = [1000]
    judged.evaluate()
    judged.accumulate()
    precision = judged.eval["precision"][0, :, 0, 0, 0]
    return precision.mean(), judged.eval["recall"][0, 0, 0, 0]


def main():
    with tempfile.TemporaryDirectory() as place:
        place = Path(place)
        all_rows = {name: mot_tree(place / "mot" / name, seed) for seed, name in enumerate(["S-01", "S-02"])}

        # MOTChallenge in place: the labels are read as motmetrics reads them.
        (place / "found").mkdir()
        for name, rows in all_rows.items():
            (place / "found" / f"{name}.txt").write_text(detections(rows, len(name) + len(rows)))
        scored = json.loads(lookout("score", place / "mot", place / "found", "--json", "--coco-out", place / "coco"))
        report = scored["reports"][0]
        targets = sum(row[0] > 3 for rows in all_rows.values() for row in rows)
        assert report["positives"] == targets and report["iou"] == 0.5, report

        # COCO: pycocotools finds the same average precision and recall.
        precision, recall = coco_figures(place / "coco")
        ours = report["AveP"]
        any_score = sum(r * n for r, n in report["max_recall_by_size_px"].values() if n) / targets
        assert abs(precision - ours) < 2e-3, (precision, ours)
        assert abs(recall - any_score) < 2e-3, (recall, any_score)
        print(f"pycocotools: AveP {precision:.4f} (ours {ours:.4f}), recall {recall:.4f} (ours {any_score:.4f})")

        # MOT and COCO imported: motmetrics finds every object again.
        lookout("import", "mot", place / "mot", "--out", place / "from-mot")
        count = sum(same_tracks(place / "from-mot" / name / "gt.txt", rows) for name, rows in all_rows.items())
        images, annotations = [], []
        for video, (name, rows) in enumerate(all_rows.items()):
            for frame in range(1, FRAMES + 1):
                images.append({"id": video * 1000 + frame, "file_name": f"{name}/img1/{frame:06}.pgm", "width": 64,
                               "height": 48, "video_id": video, "frame_id": frame})
            for frame, number, *box in rows:
                annotations.append({"id": len(annotations) + 1, "image_id": video * 1000 + frame, "category_id": 5,
                                    "bbox": box, "area": box[2] * box[3], "iscrowd": 0, "track_id": number})
        videos = [{"id": video, "name": name} for video, name in enumerate(all_rows)]
        coco = {"images": images, "annotations": annotations, "videos": videos, "categories": [{"id": 5, "name": "uav"}]}
        (place / "mot" / "instances.json").write_text(json.dumps(coco))
        assert len(COCO(str(place / "mot" / "instances.json")).anns) == count
        lookout("import", "coco", place / "mot" / "instances.json", "--out", place / "from-coco")
        count += sum(same_tracks(place / "from-coco" / name / "gt.txt", rows) for name, rows in all_rows.items())
        print(f"motmetrics: {count} boxes of imported clips read, all on their objects")

        # The clips that were imported score as the tree that they come from.
        for made in ("from-mot", "from-coco"):
            again = json.loads(lookout("score", place / made, place / "found", "--json"))
            assert again["reports"] == scored["reports"], made
        print("imported clips score as the tree that they come from")


main()
