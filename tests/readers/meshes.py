"""Meshes: STL, OBJ, PLY and glTF, beside trimesh, numpy-stl, plyfile and pygltflib."""

import re
from importlib.metadata import version

import numpy as np
import plyfile
import pygltflib
import stl
import trimesh
from PIL import Image

TRIMESH = f"trimesh {trimesh.__version__}"
NUMPY_STL = f"numpy-stl {version('numpy-stl')}"
PLYFILE = f"plyfile {version('plyfile')}"
PYGLTFLIB = f"pygltflib {version('pygltflib')}"

BOX = np.array([(x, y, z) for x in (0, 4) for y in (0, 6) for z in (0, 8)], "f4")
FACES = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    + [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)],
    "u2",
)


def look(planecast, path, *flags):
    """Scene, number of triangles, size in voxels, and number of solid ones."""
    scene, said = planecast.encode(path, "--explain", *flags)
    assert scene, said
    triangles = int(re.search(r"note: (\d+) triangles", said)[1])
    info = planecast.info(scene)
    return scene, triangles, info["dims"], info["solid_voxels"]


def solid(planecast, scene):
    """Occupancy by x, y, z."""
    raw, (nx, ny, nz) = planecast.occupancy(scene)
    return np.frombuffer(raw, "u1").reshape(nz, ny, nx).transpose(2, 1, 0)


def size(mesh, voxel):
    """Size in voxels of what a library reads."""
    return [max(1, int(np.ceil(round(float(v) / voxel, 4)))) for v in np.ptp(mesh.bounds, axis=0)]


def first(path, **options):
    return trimesh.load(path, force="mesh", process=False, **options)


def by_trimesh(planecast, format, prop, path, *flags, voxel=1):
    """Triangles and size, by both."""
    mesh = first(path)
    _, triangles, dims, _ = look(planecast, path, "--voxel", voxel, *flags)
    yield format, prop, TRIMESH, f"{len(mesh.faces)} triangles, {size(mesh, voxel)}", f"{triangles} triangles, {dims}"


def on_surface(planecast, format, prop, path, voxel):
    """Of points on the surface, those whose voxel is solid."""
    mesh = first(path)
    points = trimesh.sample.sample_surface(mesh, 20_000, seed=7)[0]
    scene, _, dims, _ = look(planecast, path, "--voxel", voxel)
    at = np.floor((points - mesh.bounds[0]) / voxel).astype(int).clip(0, np.array(dims) - 1)
    hit = int(solid(planecast, scene)[tuple(at.T)].sum())
    yield format, prop, TRIMESH, "20000 of 20000 points", f"{hit} of 20000 points"


def inside(planecast, format, prop, path, voxel, contains, library=TRIMESH):
    """Of middles of voxels that a library finds inside, those that are filled; and of filled ones that no face touches, those
    that it finds inside."""
    mesh = first(path)
    scene, _, dims, _ = look(planecast, path, "--voxel", voxel, "--fill")
    bare, _, _, _ = look(planecast, path, "--voxel", voxel)
    filled, touched = solid(planecast, scene), solid(planecast, bare)
    cells = np.stack(np.meshgrid(*map(np.arange, dims), indexing="ij"), -1).reshape(-1, 3)
    within = contains(mesh, mesh.bounds[0] + (cells + 0.5) * voxel).reshape(dims)
    deep = within & (touched == 0)
    yield format, prop, library, int(deep.sum()), int((filled & ~touched.astype(bool) & 1).sum())
    yield format, f"{prop}: all that is inside is solid", library, int(within.sum()), int((within & (filled == 1)).sum())


def stls(planecast):
    put = planecast.path
    boxes = [trimesh.creation.box((4, 6, 8)).apply_translation((10 * k, 0, 0)) for k in range(3)]
    ball = trimesh.creation.icosphere(3, 20)

    path = put("one.stl")
    path.write_text(ball.export(file_type="stl_ascii"))
    yield from by_trimesh(planecast, "STL", "text", path)
    path = put("binary.stl")
    path.write_bytes(ball.export(file_type="stl"))
    yield from by_trimesh(planecast, "STL", "binary", path)
    yield from on_surface(planecast, "STL", "surface of a ball", path, 0.7)
    of = stl.mesh.Mesh.from_file(str(path))
    _, triangles, _, _ = look(planecast, path, "--voxel", 1)
    yield "STL", "binary: triangles", NUMPY_STL, len(of.vectors), triangles
    path = put("named.stl")
    of.save(str(path), mode=stl.Mode.BINARY)
    raw = path.read_bytes()
    path.write_bytes(b"solid of a writer".ljust(80) + raw[80:])
    yield from by_trimesh(planecast, "STL", 'binary that starts with "solid"', path)
    path = put("text.stl")
    of.save(str(path), mode=stl.Mode.ASCII)
    yield from by_trimesh(planecast, "STL", "text by numpy-stl", path)

    text = "\n".join(b.export(file_type="stl_ascii").strip() for b in boxes) + "\n"
    path = put("three.stl")
    path.write_text(text)
    several = [m.vectors for m in stl.mesh.Mesh.from_multi_file(str(path), mode=stl.Mode.ASCII)]
    corners = np.concatenate(several).reshape(-1, 3)
    _, triangles, dims, n = look(planecast, path, "--voxel", 1)
    yield "STL", "text of three solids: triangles", NUMPY_STL, sum(map(len, several)), triangles
    yield "STL", "text of three solids: size", NUMPY_STL, np.ptp(corners, axis=0).astype(int).tolist(), dims
    yield "STL", "text of three solids: three shells", TRIMESH, 3 * 144, n
    one = boxes[0].export(file_type="stl_ascii")
    for what, own in [
        ("capitals", one.upper()),
        ("no name", "solid\n" + one.split("\n", 1)[1]),
        ("a blank in front", " " + one),
        ("CR LF", one.replace("\n", "\r\n")),
        ("tabs", one.replace(" ", "\t")),
    ]:
        path = put("a.stl")
        path.write_bytes(own.encode())
        _, triangles, dims, n = look(planecast, path, "--voxel", 1)
        yield "STL", f"text with {what}", TRIMESH, "12 triangles, [4, 6, 8], 144", f"{triangles} triangles, {dims}, {n}"


def objs(planecast):
    put = planecast.path
    text = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in BOX) + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES)
    torus = trimesh.creation.torus(20, 6)
    path = put("torus.obj")
    path.write_text(torus.export(file_type="obj"))
    yield from by_trimesh(planecast, "OBJ", "by trimesh", path)
    yield from on_surface(planecast, "OBJ", "surface of a torus", path, 0.7)
    for what, own in [
        ("plain", text),
        ("a byte-order mark", "\ufeff" + text),
        ("CR LF", text.replace("\n", "\r\n")),
        ("continued lines", text.replace("f 1 2", "f 1 \\\n2")),
        ("usemtl without a name", "usemtl \n" + text),
        ("indices from the end", re.sub(r"f (\d) (\d) (\d)", lambda m: "f " + " ".join(str(int(i) - 9) for i in m.groups()), text)),
        ("normals named", re.sub(r"f (\d) (\d) (\d)", r"vn 0 0 1\nf \1//1 \2//1 \3//1", text)),
    ]:
        path = put("a.obj")
        path.write_bytes(own.encode())
        _, triangles, dims, n = look(planecast, path, "--voxel", 1)
        yield "OBJ", what, TRIMESH, "12 triangles, [4, 6, 8], 144", f"{triangles} triangles, {dims}, {n}"
    # Map coordinates: the same grid near and far, where f32 has steps of 0.5.
    shapes = []
    for east, north in ((0, 0), (500_000, 4_649_776)):
        path = put("grid.obj")
        grid = [(east + 0.25 * i, north + 0.25 * j, 100) for j in range(20) for i in range(20)]
        faces = [(j * 20 + i + 1, j * 20 + i + 2, j * 20 + i + 22, j * 20 + i + 21) for j in range(19) for i in range(19)]
        path.write_text("".join("v %.2f %.2f %.2f\n" % p for p in grid) + "".join("f %d %d %d %d\n" % f for f in faces))
        shapes.append(look(planecast, path, "--voxel", "0.25", "--up", "z")[2:])
    yield "OBJ", "coordinates of maps: size and solid voxels, near and far", TRIMESH, shapes[0], shapes[1]
    # A concave polygon.
    for k in range(6):
        outline = np.roll([(0, 4), (0, 0), (4, 0), (4, 1), (1, 1), (1, 4)], k, axis=0)
        path = put("l.obj")
        path.write_text("".join(f"v {a} {b} 0\n" for a, b in outline) + "f 1 2 3 4 5 6\n")
        _, triangles, dims, n = look(planecast, path, "--voxel", "0.01")
        # Cells that an L of these corners touches, its edges included.
        column, row = np.indices((400, 400))
        cells = int(((column <= 100) | (row <= 100)).sum())
        yield "OBJ", f"concave polygon from corner {k + 1}: voxels", f"numpy {np.__version__}", cells, n
    path = put("quad.obj")
    path.write_text("v 0 0 0\nv 8 0 0\nv 8 0 8\nv 0 0 8\nf 1 2 3 4\n")
    yield from by_trimesh(planecast, "OBJ", "square", path)
    path = put("red.obj")
    path.write_text("mtllib red.mtl\nusemtl r\n" + text)
    (path.parent / "red.mtl").write_text("newmtl r\nKd 1 0 0\n")
    material = first(path).visual.material
    scene, *_ = look(planecast, path, "--voxel", 1)
    expected = "#%02x%02x%02x" % tuple(material.diffuse[:3])
    yield "OBJ", "colour of a material", TRIMESH, expected, planecast.query(scene, 0, 0, 0)["color"]
    path = put("colors.obj")
    path.write_text("".join(f"v {x:g} {y:g} {z:g} 0 1 0\n" for x, y, z in BOX) + text[text.index("f") :])
    expected = "#%02x%02x%02x" % tuple(first(path).visual.vertex_colors[0][:3])
    scene, *_ = look(planecast, path, "--voxel", 1)
    yield "OBJ", "colours of corners", TRIMESH, expected, planecast.query(scene, 0, 0, 0)["color"]


def plys(planecast):
    put = planecast.path
    ball = trimesh.creation.icosphere(3, 20)
    for encoding in ("ascii", "binary"):
        path = put("ball.ply")
        path.write_bytes(ball.export(file_type="ply", encoding=encoding))
        yield from by_trimesh(planecast, "PLY", f"{encoding} by trimesh", path)

    def elements(dtype="f4", corners=BOX):
        vertex = np.array([tuple(p) for p in corners], [(a, dtype) for a in "xyz"])
        return plyfile.PlyElement.describe(vertex, "vertex")

    def faces(more=(), values=()):
        of = np.empty(len(FACES), [("vertex_indices", "i4", (3,)), *more])
        of["vertex_indices"] = FACES
        for (name, _), value in zip(more, values):
            of[name] = value
        return plyfile.PlyElement.describe(of, "face")

    for what, dtype, options in [
        ("text", "f4", {"text": True}),
        ("little-endian", "f4", {"byte_order": "<"}),
        ("big-endian", "f4", {"byte_order": ">"}),
        ("f64", "f8", {"byte_order": "<"}),
        ("i16 corners", "i2", {"byte_order": ">"}),
    ]:
        path = put("a.ply")
        plyfile.PlyData([elements(dtype), faces()], **options).write(str(path))
        read = plyfile.PlyData.read(str(path))
        _, triangles, dims, n = look(planecast, path, "--voxel", 1)
        extent = [int(np.ptp(read["vertex"][a])) for a in "xyz"]
        yield "PLY", what, PLYFILE, f"{read['face'].count} triangles, {extent}, 144", f"{triangles} triangles, {dims}, {n}"
    path = put("first.ply")
    plyfile.PlyData([faces(), elements()]).write(str(path))
    _, triangles, dims, n = look(planecast, path, "--voxel", 1)
    yield "PLY", "faces before their corners", PLYFILE, "12 triangles, 144", f"{triangles} triangles, {n}"
    path = put("colors.ply")
    rgb = [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    plyfile.PlyData([elements(), faces(rgb, (250, 10, 30))]).write(str(path))
    face = plyfile.PlyData.read(str(path))["face"][0]
    scene, *_ = look(planecast, path, "--voxel", 1)
    expected = "#%02x%02x%02x" % tuple(face[c] for c in ("red", "green", "blue"))
    yield "PLY", "colours of faces", PLYFILE, expected, planecast.query(scene, 0, 0, 0)["color"]
    path = put("strips.ply")
    strip = np.empty(1, [("vertex_indices", object)])
    strip["vertex_indices"][0] = np.array([0, 1, 2, 3, -1, 4, 5, 6], "i4")
    square = [(0, 0, 0), (8, 0, 0), (0, 0, 8), (8, 0, 8), (0, 0, 20), (8, 0, 20), (0, 0, 28)]
    strips = plyfile.PlyElement.describe(strip, "tristrips", len_types={"vertex_indices": "i4"}, val_types={"vertex_indices": "i4"})
    plyfile.PlyData([elements(corners=square), strips]).write(str(path))
    read = plyfile.PlyData.read(str(path))["tristrips"]["vertex_indices"][0]
    ends = np.flatnonzero(np.append(read, -1) == -1)
    expected = sum(max(0, n - 2) for n in np.diff(np.append(-1, ends)) - 1)
    yield "PLY", "strips of triangles", PLYFILE, int(expected), look(planecast, path, "--voxel", 1)[1]
    path = put("surplus.ply")
    plyfile.PlyData([elements(), faces()], text=True).write(str(path))
    lines = path.read_text().split("\n")
    start = lines.index("end_header") + 1 + len(BOX)
    lines[start : start + 12] = [line + " 1 2 3" for line in lines[start : start + 12]]
    path.write_text("\n".join(lines))
    yield from by_trimesh(planecast, "PLY", "rows with more values than named", path)
    path = put("map.ply")
    points = np.array([(500_000 + x / 10, 4_649_776 + y / 10, 100) for x in range(40) for y in range(40)])
    plyfile.PlyData([elements("f8", points)]).write(str(path))
    read = plyfile.PlyData.read(str(path))["vertex"]
    apart = {(round((x - 500_000) * 10), round((y - 4_649_776) * 10)) for x, y in zip(read["x"], read["y"])}
    scene, _ = planecast.encode(path, "--voxel", "0.1", "--up", "z")
    yield "PLY", "points of a map, f64", PLYFILE, len(apart), planecast.info(scene)["solid_voxels"]


class Glb:
    """A binary glTF under construction."""

    def __init__(self):
        self.bin, self.views, self.accessors = b"", [], []

    def view(self, data):
        self.bin += b"\0" * (-len(self.bin) % 4)
        self.views.append(pygltflib.BufferView(buffer=0, byteOffset=len(self.bin), byteLength=len(data)))
        self.bin += data
        return len(self.views) - 1

    def add(self, a, kind, **more):
        a = np.ascontiguousarray(a)
        types = {"f4": 5126, "u1": 5121, "u2": 5123, "i1": 5120, "i2": 5122}
        if kind == "VEC3" and a.dtype.kind == "f":
            more |= {"min": a.min(0).tolist(), "max": a.max(0).tolist()}
        view = self.view(a.tobytes())
        self.accessors.append(
            pygltflib.Accessor(bufferView=view, componentType=types[a.dtype.str[1:]], count=len(a), type=kind, **more)
        )
        return len(self.accessors) - 1

    def save(self, path, meshes, nodes, roots=(0,), **more):
        self.bin += b"\0" * (-len(self.bin) % 4)
        gltf = pygltflib.GLTF2(
            scene=0,
            scenes=[pygltflib.Scene(nodes=list(roots))],
            nodes=nodes,
            meshes=meshes,
            accessors=self.accessors,
            bufferViews=self.views,
            buffers=[pygltflib.Buffer(byteLength=len(self.bin))],
            **more,
        )
        gltf.set_binary_blob(self.bin)
        gltf.save_binary(str(path))
        return path


def gltfs(planecast):
    put = planecast.path
    attributes, primitive, node = pygltflib.Attributes, pygltflib.Primitive, pygltflib.Node

    def mesh(position, indices, **more):
        extra = {k: more.pop(k) for k in list(more) if k.isupper() or k[-1].isdigit()}
        return pygltflib.Mesh(primitives=[primitive(attributes=attributes(POSITION=position, **extra), indices=indices, **more)])

    def cuboid():
        g = Glb()
        return g, g.add(BOX, "VEC3"), g.add(FACES.ravel(), "SCALAR")

    scene = trimesh.Scene()
    for k in range(3):
        turned = trimesh.transformations.rotation_matrix(0.4 * k, (1, 2, 3), (0, 0, 0))
        turned[:3, 3] = 30 * k, 5 * k, 0
        scene.add_geometry(trimesh.creation.icosphere(2, 9), transform=turned)
    for kind in ("glb", "gltf"):
        if kind == "glb":
            path = put("scene.glb")
            path.write_bytes(scene.export(file_type="glb"))
        else:
            path = put("scene.gltf")
            for name, data in scene.export(file_type="gltf").items():
                (path.parent / (path.name if name.endswith(".gltf") else name)).write_bytes(data)
        yield from by_trimesh(planecast, "glTF", f".{kind} with three nodes that are turned", path)
    yield from on_surface(planecast, "glTF", "surface of three balls", path, 0.7)

    square = np.array([(0, 0, 0), (8, 0, 0), (0, 0, 8), (8, 0, 8)], "f4")
    for what, mode, order in (("strip", 5, (0, 1, 2, 3)), ("fan", 6, (0, 1, 3, 2))):
        g = Glb()
        own = mesh(g.add(square, "VEC3"), g.add(np.array(order, "u2"), "SCALAR"), mode=mode)
        path = g.save(put("a.glb"), [own], [node(mesh=0)])
        _, triangles, dims, n = look(planecast, path, "--voxel", 1)
        yield "glTF", f"triangle {what}", PYGLTFLIB, "2 triangles, [8, 1, 8], 64", f"{triangles} triangles, {dims}, {n}"
    g, p, i = cuboid()
    above = node(children=[1], translation=[5, 0, 0], scale=[2, 2, 2])
    path = g.save(put("nodes.glb"), [mesh(p, i)], [above, node(mesh=0, rotation=[0, 0.5**0.5, 0, 0.5**0.5])])
    yield from by_trimesh(planecast, "glTF", "node below a node", path)
    g, p, i = cuboid()
    t = g.add(np.array([(0, 0, 0), (10, 0, 0), (20, 0, 0)], "f4"), "VEC3")
    instanced = node(mesh=0, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": t}}})
    path = g.save(put("many.glb"), [mesh(p, i)], [instanced], extensionsUsed=["EXT_mesh_gpu_instancing"])
    _, triangles, dims, n = look(planecast, path, "--voxel", 1)
    yield "glTF", "EXT_mesh_gpu_instancing", PYGLTFLIB, "36 triangles, [24, 6, 8], 432", f"{triangles} triangles, {dims}, {n}"
    g, p, i = cuboid()
    stretch = g.add(BOX * np.array([2, 0, 0], "f4"), "VEC3")
    morphed = mesh(p, i, targets=[{"POSITION": stretch}])
    morphed.weights = [0.5]
    path = g.save(put("morph.glb"), [morphed], [node(mesh=0)])
    yield "glTF", "default weight of a morph target: size", PYGLTFLIB, [8, 6, 8], look(planecast, path, "--voxel", 1)[2]
    g, p, i = cuboid()
    joints = g.add(np.tile(np.array([0, 1, 0, 0], "u1"), (8, 1)), "VEC4")
    weights = g.add(np.tile(np.array([0.5, 0.5, 0, 0], "f4"), (8, 1)), "VEC4")
    skinned = mesh(p, i, JOINTS_0=joints, WEIGHTS_0=weights)
    nodes = [node(mesh=0, skin=0, scale=[100, 100, 100]), node(), node(translation=[0, 20, 0]), node(mesh=1)]
    path = g.save(put("skin.glb"), [skinned, mesh(p, i)], nodes, (0, 1, 2, 3), skins=[pygltflib.Skin(joints=[1, 2])])
    yield "glTF", "skin: half-way between two joints", PYGLTFLIB, [4, 16, 8], look(planecast, path, "--voxel", 1)[2]
    g = Glb()
    whole = g.add(np.pad(BOX.astype("i2"), ((0, 0), (0, 1))), "VEC3", min=[0, 0, 0], max=[4, 6, 8])
    g.views[-1].byteStride = 8
    own = mesh(whole, g.add(FACES.ravel(), "SCALAR"))
    name = ["KHR_mesh_quantization"]
    path = g.save(put("whole.glb"), [own], [node(mesh=0)], extensionsUsed=name, extensionsRequired=name)
    _, triangles, dims, n = look(planecast, path, "--voxel", 1)
    yield "glTF", "KHR_mesh_quantization", PYGLTFLIB, "12 triangles, [4, 6, 8], 144", f"{triangles} triangles, {dims}, {n}"

    def painted(material, pixels=((255, 0, 0, 255), (0, 0, 255, 255)), **more):
        g, p, i = cuboid()
        uv = g.add(np.tile(np.array([0.25, 0.5], "f4"), (8, 1)), "VEC2")
        path = put("paint.glb")
        picture = path.parent / "p.png"
        image = Image.new("RGBA", (2, 1))
        image.putdata(pixels)
        image.save(picture)
        view = g.view(picture.read_bytes())
        own = mesh(p, i, TEXCOORD_0=uv, material=0)
        return g.save(
            path,
            [own],
            [node(mesh=0)],
            materials=[material],
            textures=[pygltflib.Texture(source=0)],
            images=[pygltflib.Image(bufferView=view, mimeType="image/png")],
            **more,
        )

    def picture(**extensions):
        info = pygltflib.TextureInfo(index=0, extensions=extensions)
        return pygltflib.PbrMetallicRoughness(baseColorTexture=info)

    def color(path):
        scene, *_ = look(planecast, path, "--voxel", 1)
        return planecast.query(scene, 0, 0, 0)["color"]

    material = pygltflib.Material
    yield "glTF", "picture", PYGLTFLIB, "#ff0000", color(painted(material(pbrMetallicRoughness=picture())))
    moved = picture(KHR_texture_transform={"offset": [0.5, 0]})
    yield "glTF", "KHR_texture_transform", PYGLTFLIB, "#0000ff", color(painted(material(pbrMetallicRoughness=moved)))
    turned = picture(KHR_texture_transform={"rotation": np.pi / 2, "offset": [0.1, 0]})
    yield "glTF", "KHR_texture_transform, turned", PYGLTFLIB, "#0000ff", color(painted(material(pbrMetallicRoughness=turned)))
    gloss = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0, 1, 0, 1]}}
    yield "glTF", "KHR_materials_pbrSpecularGlossiness", PYGLTFLIB, "#00ff00", color(painted(material(extensions=gloss)))
    for alpha, expected in ((0, 0), (255, 144)):
        masked = material(pbrMetallicRoughness=picture(), alphaMode="MASK")
        path = painted(masked, pixels=((0, 255, 0, alpha), (0, 255, 0, 255)))
        n = look(planecast, path, "--voxel", 1)[3]
        yield "glTF", f"alphaMode MASK, alpha {alpha}: solid voxels", PYGLTFLIB, expected, n
    g, p, i = cuboid()
    draco = ["KHR_draco_mesh_compression"]
    path = g.save(put("draco.glb"), [mesh(p, i)], [node(mesh=0)], extensionsUsed=draco, extensionsRequired=draco)
    scene, said = planecast.encode(path)
    yield "glTF", "KHR_draco_mesh_compression required", PYGLTFLIB, "refused by name", (
        "refused by name" if scene is None and draco[0] in said else said
    )


def filled(planecast):
    def contains(mesh, points):
        parts = mesh.split(only_watertight=True)
        return np.any([part.contains(points) for part in parts], axis=0)

    put = planecast.path
    ball = trimesh.creation.icosphere(3, 10)
    cavity = trimesh.creation.icosphere(3, 6)
    cavity.invert()
    for what, mesh, of in [
        ("ball", ball, lambda m, p: m.contains(p)),
        ("torus", trimesh.creation.torus(10, 3), lambda m, p: m.contains(p)),
        ("two balls that overlap", trimesh.util.concatenate([ball, ball.copy().apply_translation((7, 2, 1))]), contains),
        ("ball with a cavity", trimesh.util.concatenate([ball, cavity]), lambda m, p: m.contains(p)),
    ]:
        path = put("a.stl")
        # Turned, so that no line passes through corners.
        mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
        path.write_bytes(mesh.export(file_type="stl"))
        def welded(mesh, points, of=of):
            mesh.merge_vertices()
            return of(mesh, points)
        yield from inside(planecast, "--fill", what, path, 0.61, welded)
    open_ball = trimesh.creation.icosphere(3, 10)
    open_ball.update_faces(open_ball.triangles_center[:, 1] < 3)
    path = put("open.stl")
    path.write_bytes(open_ball.export(file_type="stl"))
    _, said = planecast.encode(path, "--voxel", "0.5", "--fill")
    closed = "closed" if open_ball.is_watertight else "open"
    yield "--fill", "ball without a cap", TRIMESH, closed, "open" if "they are open" in said else "closed"


def rows(planecast):
    for part in (stls, objs, plys, gltfs, filled):
        yield from part(planecast)
