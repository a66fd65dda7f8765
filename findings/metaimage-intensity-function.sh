#!/bin/sh
# SimpleITK 2.5.7 drops a MetaImage header's ElementToIntensityFunctionSlope and …Offset without a word.
#
# MetaIO's documentation names both fields as the function that turns stored elements into intensities, ITK's own library reads
# them, and ITK applies the like of NIfTI and DICOM. Expected: values stored · 2 − 250, so −250 to −204, or the two numbers in
# the image's metadata. Seen (SimpleITK 2.5.7, vtk 9.7.2, Linux x86-64, Python 3.11): SimpleITK gives 0 to 23 as unsigned
# bytes, and no metadata key tells of the function; VTK's reader gives 0 to 23 too, but hands out 2 and −250 as rescale slope
# and offset. A CT saved so loses its Hounsfield units in one of them only.
#
# Exits with 0 while that is so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 vtk==9.7.2 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import SimpleITK as sitk
import vtk

header = """ObjectType = Image
NDims = 3
BinaryData = True
BinaryDataByteOrderMSB = False
ElementToIntensityFunctionSlope = 2
ElementToIntensityFunctionOffset = -250
DimSize = 4 3 2
ElementType = MET_UCHAR
ElementDataFile = LOCAL
"""
open("a.mha", "wb").write(header.encode() + bytes(range(24)))
image = sitk.ReadImage("a.mha")
values = sitk.GetArrayFromImage(image)
print("SimpleITK", values.dtype, values.min(), "to", values.max(), image.GetMetaDataKeys())
reader = vtk.vtkMetaImageReader()
reader.SetFileName("a.mha")
reader.Update()
print("VTK", reader.GetRescaleSlope(), reader.GetRescaleOffset(), reader.GetOutput().GetScalarRange())
assert (values.min(), values.max()) == (0, 23)
assert not any("ntensity" in key or "lope" in key or "ffset" in key for key in image.GetMetaDataKeys())
assert (reader.GetRescaleSlope(), reader.GetRescaleOffset()) == (2, -250)
assert reader.GetOutput().GetScalarRange() == (0, 23)
PYTHON
