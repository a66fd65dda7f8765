"""Volumes: NIfTI, NRRD, MetaImage, MRC, VTK image data; beside nibabel, pynrrd, SimpleITK, mrcfile and VTK."""

import gzip

import mrcfile
import nibabel
import nrrd
import numpy as np
import SimpleITK as sitk
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

NIBABEL = f"nibabel {nibabel.__version__}"
PYNRRD = f"pynrrd {nrrd.__version__}"
SITK = f"SimpleITK {sitk.Version.VersionString()}"
MRCFILE = f"mrcfile {mrcfile.__version__}"
VTK = f"vtk {vtk.vtkVersion.GetVTKVersion()}"

RNG = np.random.default_rng(17)
# Stored x, y, z; every axis of its own length, no symmetry.
VALUES = (RNG.random((11, 9, 7)) * 200).astype("u1")
VALUES[VALUES < 60] = 0
# From the patient's right, front, head: to the world's x right, y up to the head, z to the back.
RAS_TO_WORLD = lambda a: a.transpose(0, 2, 1)[:, :, ::-1]
LPS_TO_WORLD = lambda a: a.transpose(0, 2, 1)[::-1]


def brief(solid):
    """What is solid as the size, the number of voxels and the sum of their places."""
    x, y, z = np.nonzero(solid)
    w = 1 + x + solid.shape[0] * (y + solid.shape[1] * z.astype("u8"))
    return f"{'×'.join(map(str, solid.shape))}, {solid.sum()} solid, places {int((w * w % 1000003).sum())}"


def world(planecast, path, *flags):
    scene, said = planecast.encode(path, *flags)
    if scene is None:
        return "refused: " + said.strip().split("\n")[0][-120:]
    data, (nx, ny, nz) = planecast.occupancy(scene)
    return brief(np.frombuffer(data, "u1").reshape(nz, ny, nx).transpose(2, 1, 0) > 0)


def said(planecast, path, *flags):
    return planecast.encode(path, *flags)[1]


def nifti(planecast):
    def save(image, name="a.nii"):
        path = planecast.path(name)
        nibabel.save(image, path)
        return path

    canonical = lambda path: RAS_TO_WORLD(nibabel.as_closest_canonical(nibabel.load(path)).get_fdata())
    for code in ("RAS", "LAS", "LPS", "PIR", "SAL", "ILA"):
        ornt = nibabel.orientations.axcodes2ornt(code)
        affine = nibabel.orientations.inv_ornt_aff(ornt, VALUES.shape)
        path = save(nibabel.Nifti1Image(VALUES, affine))
        yield "NIfTI-1", f"stored as {code}", NIBABEL, brief(canonical(path) >= 90), world(planecast, path, "--iso", 90)
    tilt = nibabel.affines.from_matvec(nibabel.eulerangles.euler2mat(0.2, -0.15, 0.3) @ np.diag([-2, 2, 2]), [5, 6, 7])
    path = save(nibabel.Nifti1Image(VALUES, tilt))
    yield "NIfTI-1", "oblique sform, nearest axes", NIBABEL, brief(canonical(path) >= 90), world(planecast, path, "--iso", 90)
    image = nibabel.Nifti1Image(VALUES, None)
    image.set_qform(tilt, code=1)
    image.set_sform(None, code=0)
    path = save(image)
    yield "NIfTI-1", "qform alone, left-handed", NIBABEL, brief(canonical(path) >= 90), world(planecast, path, "--iso", 90)
    both = nibabel.Nifti1Image(VALUES, np.diag([1, 1, 1, 1]))
    both.set_qform(np.diag([-1, 1, 1, 1]), code=1)
    path = save(both)
    yield "NIfTI-1", "sform before qform", NIBABEL, brief(canonical(path) >= 90), world(planecast, path, "--iso", 90)

    for dtype in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"):
        kind = np.dtype(dtype).kind
        v = (VALUES / 2 - (0 if kind == "u" else 40)).astype(dtype)
        for order in ("<", ">") if dtype in ("i2", "f8") else ("<",):
            header = nibabel.Nifti1Header(endianness=order)
            header.set_data_dtype(v.dtype.newbyteorder(order))
            path = save(nibabel.Nifti1Image(v.astype(v.dtype.newbyteorder(order)), np.eye(4), header), "a.nii.gz")
            yield f"NIfTI-1", f"values {order}{dtype}, gzip", NIBABEL, brief(canonical(path) >= 30), world(planecast, path, "--iso", 30)
    for slope, inter in ((2, -250), (-1, 255), (0.5, -30), (2, 0), (0.01, 5)):
        path = save(nibabel.Nifti1Image(VALUES, np.eye(4)))
        raw = bytearray(path.read_bytes())
        raw[112:120] = np.array([slope, inter], "<f4").tobytes()
        path.write_bytes(raw)
        yield "NIfTI-1", f"u8 · {slope} + {inter}, more than 0", NIBABEL, brief(canonical(path) > 0), world(planecast, path)
    path = save(nibabel.Nifti2Image(VALUES.astype("i2"), np.eye(4)))
    yield "NIfTI-2", "one file", NIBABEL, brief(canonical(path) >= 90), world(planecast, path, "--iso", 90)
    path = save(nibabel.Nifti2Image(VALUES, np.diag([-1, 1, 1, 1])), "a.nii.gz")
    yield "NIfTI-2", "gzip, stored as LAS", NIBABEL, brief(canonical(path) >= 90), world(planecast, path, "--iso", 90)
    for cls, name in ((nibabel.Nifti1Pair, "NIfTI-1"), (nibabel.Nifti2Pair, "NIfTI-2")):
        for ending in ("hdr", "img", "hdr.gz", "img.gz"):
            path = planecast.path("a." + ending)
            nibabel.save(cls(VALUES, np.eye(4)), path)
            yield name, f"pair, named by .{ending}", NIBABEL, brief(canonical(path) >= 90), world(planecast, path, "--iso", 90)
    path = planecast.path("a.hdr")
    nibabel.AnalyzeImage(VALUES.astype("i2"), None).to_filename(path)
    stored = np.asarray(nibabel.AnalyzeImage.from_filename(path).dataobj)
    yield "ANALYZE 7.5", "pair, axes as stored", NIBABEL, brief(stored >= 90), world(planecast, path, "--iso", 90)
    series = np.stack([VALUES, VALUES[::-1]], 3)
    path = save(nibabel.Nifti1Image(series, np.eye(4)))
    first = RAS_TO_WORLD(nibabel.load(path).get_fdata()[..., 0])
    yield "NIfTI-1", "first of a series", NIBABEL, brief(first >= 90), world(planecast, path, "--iso", 90)
    labels = nibabel.Nifti1Image((VALUES // 50).astype("i2"), np.diag([1, 1, 3, 1]))
    labels.header.set_intent("label")
    path = save(labels)
    cubes = np.repeat(canonical(path), 3, 1)
    yield "NIfTI-1", "labels, spacing 1 × 1 × 3", NIBABEL, brief(cubes != 0), world(planecast, path)
    units = nibabel.Nifti1Image(VALUES, np.diag([0.5, 0.5, 0.5, 1]))
    units.header.set_xyzt_units("micron")
    path = save(units)
    zooms = nibabel.load(path).header
    expected = f"{float(zooms.get_zooms()[0]):g} {zooms.get_xyzt_units()[0]}"
    got = "0.5 micron" if "a voxel is 0.5 µm wide" in said(planecast, path) else said(planecast, path)
    yield "NIfTI-1", "size of a voxel and its unit", NIBABEL, expected, got


def pynrrd(planecast):
    def save(data, name="a.nrrd", **header):
        path = planecast.path(name)
        nrrd.write(str(path), data, header)
        return path

    read = lambda path: nrrd.read(str(path))[0]
    for encoding in ("raw", "gzip", "ascii"):
        path = save(VALUES.astype("i2"), encoding=encoding)
        yield "NRRD", f"encoding {encoding}", PYNRRD, brief(read(path) >= 90), world(planecast, path, "--iso", 90)
    path = save(VALUES.astype(">f4"), endian="big", encoding="raw")
    yield "NRRD", "big-endian floats", PYNRRD, brief(read(path) >= 90), world(planecast, path, "--iso", 90)
    path = save(VALUES, "a.nhdr", encoding="gzip")
    yield "NRRD", "detached, gzip", PYNRRD, brief(read(path) >= 90), world(planecast, path, "--iso", 90)
    directions = [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]
    path = save(VALUES, space="left-posterior-superior", **{"space directions": np.array(directions, float)})
    yield "NRRD", "LPS, directions to the right and front", PYNRRD, brief(RAS_TO_WORLD(read(path)) >= 90), world(planecast, path, "--iso", 90)
    path = save(VALUES, space="right-anterior-superior", **{"space directions": np.eye(3)})
    yield "NRRD", "RAS", PYNRRD, brief(RAS_TO_WORLD(read(path)) >= 90), world(planecast, path, "--iso", 90)
    vectors = np.stack([VALUES, VALUES // 2, VALUES // 3], 0)
    path = save(vectors, kinds=["vector", "domain", "domain", "domain"])
    yield "NRRD", "vectors, first value", PYNRRD, brief(read(path)[0] >= 90), world(planecast, path, "--iso", 90)
    path = save(np.stack([VALUES, VALUES // 2], 3), kinds=["domain", "domain", "domain", "list"])
    yield "NRRD", "list, first volume", PYNRRD, brief(read(path)[..., 0] >= 90), world(planecast, path, "--iso", 90)
    path = save(VALUES // 50, spacings=[1.0, 1.0, 2.0])
    yield "NRRD", "labels, spacings 1 1 2", PYNRRD, brief(np.repeat(read(path), 2, 2) != 0), world(planecast, path)


def simpleitk(planecast):
    def image(values=VALUES, spacing=(1, 1, 1), direction=None):
        made = sitk.GetImageFromArray(values.transpose(2, 1, 0))
        made.SetSpacing([float(s) for s in spacing])
        if direction is not None:
            made.SetDirection([float(v) for v in np.ravel(direction)])
        return made

    def lps(path):
        """Values along the patient's left, back, head."""
        found = sitk.DICOMOrient(sitk.ReadImage(str(path)), "LPS")
        return sitk.GetArrayFromImage(found).transpose(2, 1, 0)

    turned = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    for name in ("a.mha", "a.mhd"):
        for packed in (False, True):
            path = planecast.path(name)
            sitk.WriteImage(image(), str(path), packed)
            yield "MetaImage", f"{name[2:]}, {'zlib' if packed else 'raw'}", SITK, brief(LPS_TO_WORLD(lps(path)) >= 90), world(planecast, path, "--iso", 90)
    for direction, word in ((np.diag([-1, -1, 1]), "to the right and front"), (turned, "axes in another order"), (np.diag([1, -1, -1]), "feet up")):
        path = planecast.path("a.mha")
        sitk.WriteImage(image(direction=direction), str(path))
        yield "MetaImage", f"TransformMatrix, {word}", SITK, brief(LPS_TO_WORLD(lps(path)) >= 90), world(planecast, path, "--iso", 90)
        path = planecast.path("a.nrrd")
        sitk.WriteImage(image(direction=direction), str(path))
        yield "NRRD", f"space directions, {word}", SITK, brief(LPS_TO_WORLD(lps(path)) >= 90), world(planecast, path, "--iso", 90)
        path = planecast.path("a.nii.gz")
        sitk.WriteImage(image(direction=direction), str(path))
        yield "NIfTI-1", f"qform, {word}", SITK, brief(LPS_TO_WORLD(lps(path)) >= 90), world(planecast, path, "--iso", 90)
    for dtype in ("i1", "u2", "i2", "u4", "i4", "u8", "f4", "f8"):
        path = planecast.path("a.mha")
        sitk.WriteImage(image((VALUES / 2).astype(dtype)), str(path), True)
        yield "MetaImage", f"values {dtype}, zlib", SITK, brief(LPS_TO_WORLD(lps(path)) >= 45), world(planecast, path, "--iso", 45)
    # Cubes of the closest spacing, from edge to edge, linearly.
    thick = image(VALUES.astype("f4"), (1, 1, 2.5))
    nz = round(VALUES.shape[2] * 2.5)
    cubes = sitk.Resample(thick, [*VALUES.shape[:2], nz], sitk.Transform(), sitk.sitkLinear, [0, 0, -0.75], [1, 1, 1], thick.GetDirection(), 0, sitk.sitkFloat32, True)
    path = planecast.path("a.mha")
    sitk.WriteImage(thick, str(path))
    expected = LPS_TO_WORLD(sitk.GetArrayFromImage(cubes).transpose(2, 1, 0))
    yield "MetaImage", "spacing 1 × 1 × 2.5 becomes cubes", SITK, brief(expected >= 90.3), world(planecast, path, "--iso", 90.3)
    # Otsu's threshold, of a histogram there, of the values here: both part two heaps.
    heaps = np.where(VALUES > 120, 150 + VALUES / 10, 20 + VALUES / 10).astype("f4")
    path = planecast.path("a.mha")
    sitk.WriteImage(image(heaps), str(path))
    otsu = sitk.OtsuThreshold(sitk.ReadImage(str(path)), 0, 1)
    yield "MetaImage", "Otsu's threshold", SITK, brief(LPS_TO_WORLD(sitk.GetArrayFromImage(otsu).transpose(2, 1, 0)) > 0), world(planecast, path)


def maps(planecast):
    for dtype, word in (("i1", "mode 0"), ("i2", "mode 1"), ("f4", "mode 2"), ("u2", "mode 6"), ("f2", "mode 12")):
        path = planecast.path("a.mrc")
        with mrcfile.new(path) as m:
            m.set_data((VALUES / 2).astype(dtype).transpose(2, 1, 0))
            m.voxel_size = 1.5
        with mrcfile.open(path) as m:
            expected = brief(m.data.transpose(2, 1, 0) >= 45)
        yield "MRC", word, MRCFILE, expected, world(planecast, path, "--iso", 45)
    with mrcfile.open(path) as m:
        expected = f"{float(m.voxel_size.x):g} Å"
    text = said(planecast, path, "--iso", 45)
    yield "MRC", "size of a voxel", MRCFILE, expected, "1.5 Å" if "a voxel is 1.5 Å wide" in text else text
    packed = planecast.path("a.map.gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    with mrcfile.open(packed) as m:
        expected = brief(m.data.transpose(2, 1, 0) >= 45)
    yield "CCP4", "gzip", MRCFILE, expected, world(planecast, packed, "--iso", 45)
    path = planecast.path("a.map")
    with mrcfile.new(path) as m:
        m.set_data(VALUES.astype("f4").transpose(2, 1, 0))
        m.header.mapc, m.header.mapr, m.header.maps = 3, 1, 2
        m.set_extended_header(np.zeros(160, "u1").view("V160"))
    with mrcfile.open(path) as m:
        # Axes of the data are sections, rows, columns.
        order = [int(m.header.maps), int(m.header.mapr), int(m.header.mapc)]
        expected = brief(m.data.transpose([order.index(k) for k in (1, 2, 3)]) >= 90)
    yield "CCP4", "MAPC, MAPR, MAPS 3 1 2, extended header", MRCFILE, expected, world(planecast, path, "--iso", 90)
    big = planecast.path("a.mrc")
    with mrcfile.new(big) as m:
        m.set_data(VALUES.astype("f4").transpose(2, 1, 0))
    with mrcfile.open(big) as m:
        header, data = m.header.copy(), m.data.copy()
    header = header.byteswap()
    header.machst = [0x11, 0x11, 0, 0]
    header["map"] = b"MAP "
    big.write_bytes(header.tobytes() + data.astype(">f4").tobytes())
    with mrcfile.open(big, permissive=True) as m:
        expected = brief(np.asarray(m.data).transpose(2, 1, 0) >= 90)
    yield "MRC", "big-endian", MRCFILE, expected, world(planecast, big, "--iso", 90)


def vti(planecast):
    def image(arrays, cells=False, spacing=(1, 1, 1), direction=None):
        made = vtk.vtkImageData()
        made.SetDimensions(*(n + cells for n in VALUES.shape))
        made.SetSpacing(*spacing)
        if direction is not None:
            made.SetDirectionMatrix(*np.ravel(direction))
        to = made.GetCellData() if cells else made.GetPointData()
        for name, values in arrays.items():
            flat = values.reshape(*VALUES.shape, -1).transpose(2, 1, 0, 3).reshape(-1, values.size // VALUES.size)
            array = numpy_to_vtk(np.ascontiguousarray(flat), deep=True)
            array.SetName(name)
            to.AddArray(array)
        to.SetActiveScalars(list(arrays)[-1])
        return made

    def save(made, mode="appended", coded=False, packer=None, wide=True):
        path = planecast.path("a.vti")
        writer = vtk.vtkXMLImageDataWriter()
        writer.SetFileName(str(path))
        writer.SetInputData(made)
        {"appended": writer.SetDataModeToAppended, "binary": writer.SetDataModeToBinary, "ascii": writer.SetDataModeToAscii}[mode]()
        writer.SetEncodeAppendedData(coded)
        writer.SetCompressor(packer)
        (writer.SetHeaderTypeToUInt64 if wide else writer.SetHeaderTypeToUInt32)()
        writer.SetBlockSize(256)
        assert writer.Write() == 1
        return path

    def read(path, cells=False):
        reader = vtk.vtkXMLImageDataReader()
        reader.SetFileName(str(path))
        reader.Update()
        data = reader.GetOutput().GetCellData() if cells else reader.GetOutput().GetPointData()
        flat = vtk_to_numpy(data.GetScalars())
        return flat.reshape(*VALUES.shape[::-1], -1)[..., 0].transpose(2, 1, 0)

    plain = image({"density": VALUES})
    for packer, word in ((None, "not packed"), (vtk.vtkZLibDataCompressor(), "zlib"), (vtk.vtkLZ4DataCompressor(), "LZ4")):
        for mode, coded, wide in (("binary", False, True), ("binary", False, False), ("appended", False, True), ("appended", True, True), ("appended", False, False)):
            path = save(plain, mode, coded, packer, wide)
            how = f"{'appended ' if mode == 'appended' else ''}{'base64' if coded or mode == 'binary' else 'raw'}, {word}, {64 if wide else 32} bits"
            yield "VTI", how, VTK, brief(read(path) >= 90), world(planecast, path, "--iso", 90)
    path = save(plain, "ascii")
    yield "VTI", "ascii", VTK, brief(read(path) >= 90), world(planecast, path, "--iso", 90)
    for dtype in ("i1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"):
        path = save(image({"density": (VALUES / 2).astype(dtype)}), packer=vtk.vtkZLibDataCompressor())
        yield "VTI", f"values {dtype}", VTK, brief(read(path) >= 45), world(planecast, path, "--iso", 45)
    path = save(image({"other": VALUES[::-1], "density": VALUES}))
    yield "VTI", "the array named as scalars", VTK, brief(read(path) >= 90), world(planecast, path, "--iso", 90)
    path = save(image({"density": VALUES}, cells=True))
    yield "VTI", "cells", VTK, brief(read(path, True) >= 90), world(planecast, path, "--iso", 90)
    path = save(image({"vector": np.stack([VALUES, VALUES // 2, VALUES // 3], 3)}))
    yield "VTI", "vectors, first value", VTK, brief(read(path) >= 90), world(planecast, path, "--iso", 90)
    path = save(image({"labels": VALUES // 50}, spacing=(1, 2, 1)))
    yield "VTI", "labels, spacing 1 × 2 × 1", VTK, brief(np.repeat(read(path), 2, 1) != 0), world(planecast, path)
    path = save(image({"density": VALUES}, direction=[[0, 1, 0], [0, 0, -1], [1, 0, 0]]))
    # The file's axes run along z, x and against y.
    yield "VTI", "Direction", VTK, brief(read(path).transpose(1, 2, 0)[:, ::-1] >= 90), world(planecast, path, "--iso", 90)


def rows(planecast):
    for of in (nifti, pynrrd, simpleitk, maps, vti):
        yield from of(planecast)
