"""globule in ParaView: a reader, the surface as triangles, and the exact surface in the view's images.

Load this file in Tools > Manage Plugins, or by LoadPlugin in a script. ParaView's Python must find
globule: docs/how-to/paraview.md.
"""

import os
import sys
import weakref
from dataclasses import replace

import globule as gb
import numpy as np
from globule._base.structured import parse_arguments
from globule.formats import READABLE, read_contents
from globule.formats.kind import kind_or_none
from globule.formats.vtk_parts import parts_of, per_particle
from globule.measure.surface import box_of, default_spacing
from globule.pieces.shown import shown_scene
from globule.render.image_sequence import KeptScene
from globule.render.presets import PRESETS
from globule.render.sequence import find_files, with_frames
from globule.scene.scene import KERNELS, SURFACES
from paraview.util.vtkAlgorithm import VTKPythonAlgorithmBase, smdomain, smhint, smproperty, smproxy
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkCommonExecutionModel import vtkAlgorithm
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Keys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from globule_paraview_tools import fill, from_all, of_views, particles_of, process, said_in_a_line, shown, world

CELL = 0.8  # edge of the triangles' cells in spacings: the volume of a splash is within 1 %


def properties(*rows):
    """The XML of properties: each a name, its default, what it is, and the texts to choose from. Their
    values go to `Set<name>`."""
    xml = ""
    for name, default, about, *choices in rows:
        text = isinstance(default, str)
        kind, values = ("String", default) if text else ("Double", " ".join(map(str, np.atleast_1d(default))))
        words = "".join(f'<String value="{word}"/>' for word in choices)
        domain = f'<StringListDomain name="list">{words}</StringListDomain>' if words else ""
        xml += (
            f'<{kind}VectorProperty name="{name}" command="Set{name}" default_values="{values}" '
            f'number_of_elements="{1 if text else np.size(default)}">{domain}'
            f"<Documentation>{about}</Documentation></{kind}VectorProperty>"
        )
    return smproperty.xml(xml)


OF_SURFACE = (
    ("Surface", "auto", "auto chooses by the particles, as globule render", "auto", *SURFACES),
    ("Kernel", "murakami", "of the particles' field", *KERNELS),
    ("Threshold", 0.0, "iso-value of the field; 0: by kernel"),
    ("Support", 0.0, "radius of all kernels, world units; 0: the particles' own, else two spacings"),
    ("ParticleSpacing", 0.0, "world units; 0: measured at the first frame, and kept"),
)


class OfParticles(VTKPythonAlgorithmBase):
    """What has properties of these names; a filter with one scene for all frames."""

    names = ("Surface", "Kernel", "Threshold", "Support", "ParticleSpacing", "CellSize", "Attributes", "Preset",
             "ColorBy", "Colormap", "Range", "Options", "Times")  # fmt: skip

    def __init__(self, n_inputs=1):
        VTKPythonAlgorithmBase.__init__(self, nInputPorts=n_inputs, nOutputPorts=1, outputType="vtkPolyData")
        self.given = {}
        self.changed()

    def __init_subclass__(cls, **options):
        def setter(name):
            def change(self, *values):
                if self.given.get(name) != values:
                    self.given[name] = values
                    self.changed()
                    self.Modified()

            return change

        for name in OfParticles.names:
            setattr(cls, f"Set{name}", setter(name))

    def value(self, name, default=None):
        """What a property was set to; the default for 0 and an empty text."""
        values = self.given.get(name, (None,))
        return (values if len(values) > 1 else values[0]) if any(values) else default

    def changed(self):
        """A property has another value."""
        self.kept = KeptScene(grows=True)

    def FillInputPortInformation(self, port, info):
        """Points of any kind."""
        info.Set(vtkAlgorithm.INPUT_REQUIRED_DATA_TYPE(), "vtkPointSet")
        return 1

    def scene_of(self, particles):
        """The scene of a frame, made as the command line makes it."""
        asked = {"kernel": self.value("Kernel", "murakami"), "threshold": self.value("Threshold"),
                 "support": self.value("Support")}  # fmt: skip
        spacing, surface = self.value("ParticleSpacing"), self.value("Surface", "auto")
        surface = "smooth" if surface == "auto" and spacing else surface

        if surface == "auto":
            return self.kept.show(particles, lambda p: shown_scene(p, **asked))
        return self.kept.show(particles, lambda p: gb.Scene(p, surface=surface, spacing=spacing, **asked))


@smproxy.reader(
    name="GlobuleReader", label="Globule Reader", file_description="Particles (globule)", support_reload=False,
    extensions=[end.lstrip(".") for end in READABLE],
)  # fmt: skip
@properties(
    ("Options", "", "arguments of globule.read, such as where='type == 1', scale=0.001"),
    ("Times", "auto", "auto: those of collections, else numbers; file: reads each file once", "auto", "number", "file"),
)
class GlobuleReader(OfParticles):
    """Particles of any format that globule reads, and all frames of files."""

    def __init__(self):
        self.files, self.frames, self.clock, self.options = [], [], [], {}
        OfParticles.__init__(self, n_inputs=0)

    @smproperty.stringvector(
        name="FileNames", clean_command="RemoveAllFileNames", command="AddFileName", repeat_command="1",
        number_of_elements="1", panel_visibility="never",
    )  # fmt: skip
    @smdomain.filelist()
    @smhint.filechooser([end.lstrip(".") for end in READABLE], "Particles (globule)")
    def AddFileName(self, name):
        """One more file, or a pattern."""
        self.files.append(name)
        self.Modified()

    def RemoveAllFileNames(self):
        """Other files follow."""
        self.files.clear()
        self.Modified()

    @smproperty.doublevector(name="TimestepValues", information_only="1", si_class="vtkSITimeStepsProperty")
    def GetTimestepValues(self):
        """The times of all frames."""
        return self.clock or None

    def time_of(self, i, name):
        """The time of a frame."""
        form, time, how = getattr(kind_or_none(name), "format", None), None, self.value("Times", "auto")
        if how == "auto" and form in ("pvd", "series"):
            time = parts_of(name, form, getattr(name, "frame", 0)).time
        elif how == "file":
            time = read_contents(name, **self.options).time
        return float(i if time is None else time)

    @said_in_a_line
    def RequestInformation(self, request, inputs, output):
        """The times."""
        info, self.frames, self.clock = output.GetInformationObject(0), [], []
        self.options = parse_arguments("Options", self.value("Options", ""))
        frames = with_frames(find_files(self.files), **self.options) if self.files else []
        self.clock = [self.time_of(i, name) for i, name in enumerate(frames)]
        if (np.diff(self.clock) <= 0).any():
            self.clock = [float(i) for i in range(len(frames))]
        self.frames = frames
        info.Set(vtkAlgorithm.CAN_HANDLE_PIECE_REQUEST(), 1)
        if len(self.clock) > 1:
            info.Set(Keys.TIME_STEPS(), self.clock, len(self.clock))
            info.Set(Keys.TIME_RANGE(), [self.clock[0], self.clock[-1]], 2)
        return 1

    @said_in_a_line
    def RequestData(self, request, inputs, output):
        """The particles of one frame; with several processes, a slab of them on each."""
        info, out, key = output.GetInformationObject(0), vtkPolyData.GetData(output), Keys.UPDATE_TIME_STEP()
        if not self.frames:
            return 1
        time = info.Get(key) if info.Has(key) else self.clock[0]
        i = max(0, int(np.searchsorted(self.clock, time + 1e-9 * abs(time), side="right")) - 1)
        particles = read_contents(self.frames[i], **self.options).particles
        piece, n = info.Get(Keys.UPDATE_PIECE_NUMBER()), info.Get(Keys.UPDATE_NUMBER_OF_PIECES()) or 1
        if n > 1 and len(particles):
            order = np.argsort(particles.positions[:, np.argmax(np.ptp(particles.positions, axis=0))], kind="stable")
            particles = particles[np.sort(order[len(order) * piece // n : len(order) * (piece + 1) // n])]
        places = world(particles.positions, particles.origin)
        fill(out, places, np.arange(len(particles))[:, None], per_particle(particles))
        out.GetInformation().Set(out.DATA_TIME_STEP(), time)
        return 1


@smproxy.filter(name="GlobuleSurface", label="Globule Surface", support_reload=False)
@smproperty.input(name="Input")
@smdomain.datatype(dataTypes=["vtkPointSet"])
@properties(
    *OF_SURFACE,
    ("CellSize", 0.0, f"edge of the cells of the triangles, world units; 0: {CELL} spacings"),
    ("Attributes", "all", "at the triangles' corners: all of the particles, or none", "all", "none"),
)
class GlobuleSurface(OfParticles):
    """The surface of particles as triangles; with several processes, a part of them on each."""

    @said_in_a_line
    def RequestData(self, request, inputs, output):
        """The mesh of a frame; its volume and area as field data."""
        particles, out = particles_of(self.GetInputData(inputs, 0, 0)), vtkPolyData.GetData(output)
        if not len(particles.finite_positions()):
            return 1
        scene = self.scene_of(particles)
        cell = self.value("CellSize", default_spacing(scene) * (CELL / 0.5 if scene.surface == "smooth" else 1))
        names = [] if self.value("Attributes", "all") == "none" else [*particles.attributes]
        mesh = gb.measure.mesh_surface(scene, cell, names, part=process())
        fill(out, world(mesh.vertices, mesh.origin), mesh.faces, mesh.values)
        out.GetPointData().SetNormals(numpy_to_vtk(mesh.normals, deep=True))
        out.GetPointData().GetNormals().SetName("Normals")
        a, b, c = (mesh.vertices[mesh.faces[:, k]] - particles.bounds()[0].astype(float) for k in range(3))
        volume = sum(from_all(float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6))
        for name, number in {"volume": volume, "area": sum(from_all(mesh.area)), "cell size": cell}.items():
            found = numpy_to_vtk(np.array([number]), deep=True)
            found.SetName(name)
            out.GetFieldData().AddArray(found)
        return 1


@smproxy.filter(name="GlobuleImage", label="Globule Image", support_reload=False)
@smproperty.input(name="Input")
@smdomain.datatype(dataTypes=["vtkPointSet"])
@properties(
    *OF_SURFACE,
    ("Preset", "none", "light and material", "none", *PRESETS),
    ("ColorBy", "", "an attribute, x, y or z"),
    ("Colormap", "auto", "name of a color map"),
    ("Range", (0.0, 0.0), "values at the map's ends; 0, 0: the frame's"),
)
class GlobuleImage(OfParticles):
    """The exact surface in the images of all views that show this filter, between their meshes."""

    actors, watched, scene = {}, None, None
    empty = True  # the views show nothing: no particles, or a mistake

    def changed(self):
        """Everything is made anew."""
        OfParticles.changed(self)
        for renderer, (actor, show) in self.actors.items():
            actor.remove()
            renderer.RemoveObserver(show)
        self.actors = {}

    @said_in_a_line
    def RequestData(self, request, inputs, output):
        """The box of the particles; the surface itself is drawn by the views, of the first process."""
        self.empty = True
        particles = particles_of(self.GetInputData(inputs, 0, 0))
        if process()[0] or not len(particles.finite_positions()):
            return 1
        looks = self.looks()
        if looks["color_by"]:  # here, a mistake is said once, not at each image
            gb.color_by(particles, looks.pop("color_by"), **looks)
        before, self.scene = self.scene, self.scene_of(particles)
        if before is not self.scene:
            GlobuleImage.changed(self)
        for actor, _ in self.actors.values():
            actor.refresh()
        self.draw_in_views()
        self.empty = False
        corners = np.array(np.meshgrid(*np.transpose(box_of(self.scene)), indexing="ij")).reshape(3, 8).T
        fill(vtkPolyData.GetData(output), world(corners, particles.origin), np.empty((0, 1)), {})
        return 1

    def looks(self):
        """The colors, as arguments of globule.render."""
        looks = {"color_by": self.value("ColorBy"), "colormap": self.value("Colormap", "auto")}
        return looks | ({"range": self.value("Range")} if self.value("Range") else {})

    def draw_in_views(self):
        """Add the surface to the views that do not have it yet, and to those to come."""
        if self.scene is None:
            return
        sources, views = of_views()
        if all(one.GetClientSideObject() is not self for one in sources):
            return
        preset, looks = self.value("Preset", "none"), self.looks()
        for view in views:
            renderer = view.GetClientSideObject().GetRenderer()
            if renderer not in self.actors:
                settings = gb.RenderSettings() if preset == "none" else gb.load_preset(preset, self.scene)
                settings = replace(settings, ground=None, edge_samples=1)  # ParaView smooths edges itself
                actor = gb.pyvista.add_particles(renderer, self.scene, settings, **looks)
                # Before the actor's own observer, which draws.
                self.actors[renderer] = actor, renderer.AddObserver("StartEvent", shown(weakref.ref(self), actor), 1.0)
        if self.watched is None:
            it = weakref.ref(self)
            self.watched = views[0].GetSessionProxyManager() if views else None
            if self.watched:
                self.watched.AddObserver("RegisterEvent", lambda *_: it() and it().draw_in_views())
