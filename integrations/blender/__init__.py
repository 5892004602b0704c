"""globule in Blender: sequences of particles as point clouds or as smooth surfaces, one for each frame.

File > Import > Particles (globule), or `bpy.ops.import_scene.globule(filepath=…)`. Blender's Python must
have globule: docs/how-to/blender.md.
"""

import json
import os

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.props import CollectionProperty, EnumProperty, FloatProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

bl_info = {
    "name": "Globule",
    "author": "The globule contributors",
    "version": (0, 2, 0),
    "blender": (4, 2, 0),
    "location": "File > Import > Particles (globule)",
    "description": "Particles of simulations as point clouds and smooth surfaces",
    "category": "Import-Export",
}
KEY = "globule"  # the property of an object that says what it shows, as JSON
CELL = 0.8  # edge of a mesh's cells, in the particles' spacings
VELOCITIES = ("velocity", "velocities", "vel", "v")
MISTAKES = (OSError, ValueError, TypeError, LookupError, ImportError, MemoryError)  # of files and settings
_shown = {}  # by the object's name and what it shows: `Frames`


class Frames:
    """The frames of an object: its files, and the one scene that they share."""

    def __init__(self, asked):
        import globule as gb
        from globule._base.structured import parse_arguments
        from globule.formats.vtk_parts import per_particle
        from globule.pieces.shown import shown_scene
        from globule.render.image_sequence import KeptScene
        from globule.render.sequence import find_files, with_frames

        self.gb, self.values_of, self.shown_scene, self.asked = gb, per_particle, shown_scene, asked
        self.options = parse_arguments("Options", asked["options"])
        self.names = with_frames(find_files([bpy.path.abspath(name) for name in asked["files"]]), **self.options)
        self.kept, self.at, self.origin = KeptScene(grows=True), None, None

    def particles(self, i):
        """The particles of a frame that have places, all from the origin of the first."""
        found = self.gb.read(self.names[i], **self.options)
        finite = np.isfinite(found.positions).all(axis=1)
        found = found if finite.all() else found[finite]
        if self.origin is None and len(found):
            self.origin = found.origin
        return found.at(self.origin) if len(found) else found

    def spacing(self, particles):
        """That of the particles, world units."""
        return self.asked["spacing"] or self.gb.Scene(particles.positions, device="cpu").spacing or 1.0

    def scene(self, particles):
        """The scene of a frame, made as globule's command line makes it."""
        surface, spacing = self.asked["surface"], self.asked["spacing"] or None
        if surface == "auto" and spacing is None:
            return self.kept.show(particles, self.shown_scene)
        surface = "smooth" if surface == "auto" else surface
        return self.kept.show(particles, lambda p: self.gb.Scene(p, surface=surface, spacing=spacing))

    def colors(self, particles):
        """The particles' colors, (N, 3) linear, by a value of theirs if one is asked for."""
        if self.asked["color_by"]:
            low, high = self.asked["range"]
            limits = {"range": (low, high)} if low != high else {}
            particles = self.gb.color_by(particles, self.asked["color_by"], **limits)
        return None if particles.color is None else np.broadcast_to(particles.color, (len(particles), 3))

    def frame(self, i):
        """Points, triangles, normals and arrays at the points of a frame."""
        particles = self.particles(i)
        arrays, color = dict(self.values_of(particles)), self.colors(particles)
        arrays.pop("color", None)
        if color is not None:
            arrays["Color"] = color
        for name in VELOCITIES:  # Cycles' name for motion blur, a way in a second of the movie
            if name in arrays and arrays[name].shape[1:] == (3,):
                arrays["velocity"] = np.asarray(arrays.pop(name), np.float32) * self.asked["pace"]
                break
        if self.asked["kind"] == "POINTS" or not len(particles):
            arrays["radius"] = arrays.get("radius", np.full(len(particles), self.spacing(particles) / 2))
            return np.asarray(particles.positions), np.empty((0, 3), np.int32), None, arrays
        from globule.measure.surface import default_spacing

        particles = self.gb.Particles(
            particles.positions, attributes={k: a for k, a in arrays.items() if k != "support"}
        )
        scene = self.scene(particles)
        cell = default_spacing(scene) * (CELL / 0.5 if scene.surface == "smooth" else 1)
        mesh = self.gb.measure.mesh_surface(scene, self.asked["cell"] or cell, [*particles.attributes])
        return mesh.vertices, mesh.faces, mesh.normals, mesh.values


def fill(mesh, points, faces, normals, arrays):
    """Points, triangles and arrays at the points as Blender's mesh."""
    mesh.clear_geometry()
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points, np.float32).ravel())
    if len(faces):
        mesh.loops.add(faces.size)
        mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, np.int32).ravel())
        mesh.polygons.add(len(faces))
        mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    for name, array in arrays.items():
        array = np.asarray(array, np.float32)
        kind = {(): "FLOAT", (3,): "FLOAT_VECTOR"}.get(array.shape[1:])
        if name == "Color":
            kind, array = "FLOAT_COLOR", np.concatenate([array, np.ones((len(array), 1), np.float32)], axis=1)
        if kind is None or name in ("position", "normal"):
            continue
        made = mesh.attributes.new(name, kind, "POINT")
        field = {"FLOAT": "value", "FLOAT_VECTOR": "vector", "FLOAT_COLOR": "color"}[kind]
        made.data.foreach_set(field, np.nan_to_num(array).ravel())
    mesh.update(calc_edges=True)
    if normals is not None and len(faces):
        mesh.shade_smooth()
        mesh.normals_split_custom_set_from_vertices(normals)


def show(thing, number):
    """Show the frame of an object at the scene's frame."""
    asked = json.loads(thing[KEY])
    key = (thing.name, thing[KEY])
    if key not in _shown:
        _shown[key] = Frames(asked)
    frames = _shown[key]
    i = min(max(number - asked["start"], 0), len(frames.names) - 1)
    if frames.at != i:
        frames.at = None
        fill(thing.data, *frames.frame(i))
        frames.at = i
    return frames


@persistent
def on_frame(scene, *_):
    """Before each frame: its particles."""
    for thing in scene.objects:
        if KEY in thing and thing.type == "MESH":
            try:
                show(thing, scene.frame_current)
            except MISTAKES as error:
                thing.data.clear_geometry()  # else the frame before would be taken for this one
                print(f"globule: {thing.name}: {error}")


@persistent
def on_load(*_):
    """Another file: other objects."""
    _shown.clear()
    for scene in bpy.data.scenes:
        on_frame(scene)


def material(kind, colored):
    """Water, or a plain surface in the particles' colors."""
    made = bpy.data.materials.new(f"globule {kind.lower()}")
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    body = nodes["Principled BSDF"]
    body.inputs["Base Color"].default_value = (0.25, 0.52, 0.8, 1)
    body.inputs["Roughness"].default_value = 0.3
    if kind == "WATER":
        for name, value in (("Roughness", 0.0), ("IOR", 1.333), ("Transmission Weight", 1.0)):
            body.inputs[name].default_value = value
        body.inputs["Base Color"].default_value = (0.8, 0.95, 1, 1)
    if colored:
        values = nodes.new("ShaderNodeAttribute")
        values.attribute_name = "Color"
        links.new(values.outputs["Color"], body.inputs["Base Color"])
    return made


def as_points(thing, look):
    """Let an object show its vertices as a point cloud, of their radius."""
    tree = bpy.data.node_groups.new("globule points", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    begin, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    points, radius = tree.nodes.new("GeometryNodeMeshToPoints"), tree.nodes.new("GeometryNodeInputNamedAttribute")
    paint = tree.nodes.new("GeometryNodeSetMaterial")
    radius.data_type = "FLOAT"
    radius.inputs["Name"].default_value = "radius"
    paint.inputs["Material"].default_value = look
    tree.links.new(begin.outputs[0], points.inputs["Mesh"])
    tree.links.new(radius.outputs["Attribute"], points.inputs["Radius"])
    tree.links.new(points.outputs[0], paint.inputs["Geometry"])
    tree.links.new(paint.outputs[0], end.inputs[0])
    thing.modifiers.new("globule points", "NODES").node_group = tree


class ImportParticles(bpy.types.Operator, ImportHelper):
    """Import particles: one file, one with several frames, or a series of files"""

    bl_idname = "import_scene.globule"
    bl_label = "Import particles"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012
    # fmt: off
    filter_glob: StringProperty(default="*", options={"HIDDEN"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    kind: EnumProperty(name="As", items=[("SURFACE", "Smooth surface", ""), ("POINTS", "Point cloud", "")])
    surface: EnumProperty(name="Surface", items=[(k, k, "") for k in ("auto", "smooth", "balls", "spheres")])
    spacing: FloatProperty(name="Particle spacing", min=0, description="0: measured at the first frame")
    cell: FloatProperty(name="Cell size", min=0, description="Edge of the triangles' cells; 0: 0.8 spacings")
    color_by: StringProperty(name="Color by", description="An attribute, x, y or z")
    low: FloatProperty(name="From", description="Value at the color map's lower end")
    high: FloatProperty(name="To", description="Value at its upper end; as From: those of each frame")
    look: EnumProperty(name="Material", items=[("PLAIN", "Plain", ""), ("WATER", "Water", "")])
    seconds: FloatProperty(name="Seconds a frame", default=0, min=0, precision=4,
                           description="Of the simulation, for motion blur; 0: one over the frame rate")
    start: IntProperty(name="First frame", default=1)
    options: StringProperty(name="Options", description="Arguments of globule.read: where='type == 1', scale=0.001")
    # fmt: on

    def execute(self, context):
        """Make the object, and show the present frame."""
        chosen = [os.path.join(self.directory, one.name) for one in self.files if one.name]
        scene = context.scene
        asked = {"files": chosen or [self.filepath], "range": [self.low, self.high]}
        asked |= {name: getattr(self, name) for name in
                  ("kind", "surface", "spacing", "cell", "color_by", "start", "options")}  # fmt: skip
        asked["pace"] = self.seconds * scene.render.fps / scene.render.fps_base if self.seconds else 1.0
        name = os.path.splitext(os.path.basename(asked["files"][0]))[0]
        thing = bpy.data.objects.new(name, bpy.data.meshes.new(name))
        thing[KEY] = json.dumps(asked)
        try:
            frames = show(thing, scene.frame_current)
            up = frames.gb.read(frames.names[0], **frames.options).up
        except ImportError as error:
            self.report({"ERROR"}, f"{error}: Blender's Python needs globule, see docs/how-to/blender.md")
        except MISTAKES as error:
            self.report({"ERROR"}, str(error))
        else:
            if up[1] > 0.5:  # Blender has z upwards
                thing.rotation_euler = (np.pi / 2, 0, 0)
            look = material(self.look, "Color" in thing.data.attributes)
            thing.data.materials.append(look)
            if self.kind == "POINTS":
                as_points(thing, look)
            context.collection.objects.link(thing)
            context.view_layer.objects.active = thing
            scene.frame_end = max(scene.frame_end, self.start + len(frames.names) - 1)
            return {"FINISHED"}
        bpy.data.meshes.remove(thing.data)  # and the object with it
        return {"CANCELLED"}


def in_menu(menu, context):
    """File > Import."""
    menu.layout.operator(ImportParticles.bl_idname, text="Particles (globule)")


def register():
    """Switch the add-on on."""
    bpy.utils.register_class(ImportParticles)
    bpy.types.TOPBAR_MT_file_import.append(in_menu)
    bpy.app.handlers.frame_change_pre.append(on_frame)
    bpy.app.handlers.load_post.append(on_load)


def unregister():
    """Switch it off."""
    bpy.app.handlers.load_post.remove(on_load)
    bpy.app.handlers.frame_change_pre.remove(on_frame)
    bpy.types.TOPBAR_MT_file_import.remove(in_menu)
    bpy.utils.unregister_class(ImportParticles)
