"""One sheet of what `planecast FILE` shows of files, with no flags: sheet.py PROGRAM SHEET.png FILE...; needs Pillow alone.

With --before PROGRAM in front, each file's picture of another program stands to the left: `encode` and `render` without flags.
"""
import os, shutil, subprocess, sys, tempfile
from PIL import Image, ImageDraw

WIDE, HIGH, COLUMNS = 384, 216, 4


def picture(program, file, scene):
    """What a program shows of a copy of `file`; the words where it shows nothing."""
    with tempfile.TemporaryDirectory() as folder:
        copy = os.path.join(folder, os.path.basename(file))
        (shutil.copytree if os.path.isdir(file) else shutil.copy)(file, copy)
        there = set(os.listdir(folder))
        # Without a display it is drawn.
        env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
        steps = [["encode", copy, "-o", "s.pcast"], ["render", "s.pcast", "-o", "s.png", "--size", "1280x720"]] if scene else [[copy]]
        said = ""
        for step in steps:
            done = subprocess.run([program, *step], cwd=folder, env=env, capture_output=True, text=True)
            said = done.stderr.strip().splitlines()[-1:] or [""]
            if done.returncode:
                break
        stills = [f for f in set(os.listdir(folder)) - there if f.endswith(".png")]
        if stills:
            return Image.open(os.path.join(folder, stills[0])).convert("RGB").resize((WIDE, HIGH), Image.LANCZOS)
        blank = Image.new("RGB", (WIDE, HIGH))
        ImageDraw.Draw(blank).text((8, HIGH // 2), said[0].replace(folder + "/", "")[:60], fill="white")
        return blank


def main(args):
    before = args[1] if args[:1] == ["--before"] else None
    program, sheet, *files = args[2:] if before else args
    pictures = []
    for file in files:
        for who, scene in ([(before, True)] if before else []) + [(program, False)]:
            image = picture(os.path.abspath(who), file, scene)
            ImageDraw.Draw(image).text((4, 2), os.path.basename(file) + (", before" if scene else ""), fill="yellow")
            pictures.append(image)
    out = Image.new("RGB", (WIDE * COLUMNS, HIGH * -(-len(pictures) // COLUMNS)))
    for i, image in enumerate(pictures):
        out.paste(image, (i % COLUMNS * WIDE, i // COLUMNS * HIGH))
    out.save(sheet)


main(sys.argv[1:])
