#!/bin/sh
# SimpleITK 2.5.7 adds the intercept of a NIfTI file whose slope is 0; nibabel 5.4.2 does not.
#
# nifti1.h: "If the scl_slope field is nonzero, then each voxel value in the dataset should be scaled as
# y = scl_slope * x + scl_inter"; slope 0 means that values are as stored. Headers whose unused fields hold 0 are common, and
# an intercept left over beside a slope of 0 is valid. Expected: both give the stored values 0 to 23. Seen (SimpleITK 2.5.7,
# nibabel 5.4.2, Linux x86-64, Python 3.11): nibabel 0 to 23, SimpleITK 7 to 30, without a word.
#
# Exits with 0 while that is so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 nibabel==5.4.2 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import nibabel
import numpy as np
import SimpleITK as sitk

nibabel.save(nibabel.Nifti1Image(np.arange(24, dtype="u1").reshape(4, 3, 2), np.eye(4)), "a.nii")
data = bytearray(open("a.nii", "rb").read())
data[112:120] = np.array([0, 7], "<f4").tobytes()
open("a.nii", "wb").write(data)
by_nibabel = nibabel.load("a.nii").get_fdata()
by_itk = sitk.GetArrayFromImage(sitk.ReadImage("a.nii"))
print("nibabel", by_nibabel.min(), "to", by_nibabel.max())
print("SimpleITK", by_itk.min(), "to", by_itk.max())
assert (by_nibabel.min(), by_nibabel.max()) == (0, 23)
assert (by_itk.min(), by_itk.max()) == (7, 30)
PYTHON
