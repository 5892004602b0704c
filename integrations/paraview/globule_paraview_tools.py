"""What the filters of globule_paraview.py share: processes, VTK's data, and ParaView's views."""

import functools
import pickle

import globule as gb
import numpy as np
from globule.formats.vtk_parts import join
from globule.scene.sources import as_particles
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkPoints, vtkUnsignedCharArray
from vtkmodules.vtkCommonDataModel import vtkCellArray
from vtkmodules.vtkParallelCore import vtkMultiProcessController


def said_in_a_line(request):
    """A request of a filter whose mistakes are one line of ParaView's messages; it gives nothing then,
    so that no frame before stays in sight."""

    @functools.wraps(request)
    def of(self, *given):
        try:
            return request(self, *given)
        except (OSError, ValueError, TypeError, ImportError, MemoryError) as error:
            vtkOutputWindow.GetInstance().DisplayErrorText(f"{type(self).__name__}: {error}\n")
            return 1

    return of


def process():
    """The number of this process among ParaView's of one run, and how many there are."""
    all_of_them = vtkMultiProcessController.GetGlobalController()
    return (all_of_them.GetLocalProcessId(), all_of_them.GetNumberOfProcesses()) if all_of_them else (0, 1)


def from_all(value):
    """The values of all processes, in their order."""
    if process()[1] == 1:
        return [value]
    found = []
    data = pickle.dumps(value)
    for one in (np.int64(len(data)).tobytes(), data):
        both = numpy_to_vtk(np.frombuffer(one, np.uint8), deep=True), vtkUnsignedCharArray()
        vtkMultiProcessController.GetGlobalController().AllGatherV(*both)
        found.append(vtk_to_numpy(both[1]).tobytes())
    ends = np.cumsum(np.frombuffer(found[0], np.int64))
    return [pickle.loads(found[1][a:b]) for a, b in zip([0, *ends], ends, strict=False)]


def particles_of(data):
    """The particles of a VTK data set, of all processes."""
    parts = [part for part in from_all(as_particles("input", data)) if len(part)]
    return join(parts) if parts else gb.Particles(np.empty((0, 3)))


def fill(output, points, cells, arrays):
    """Points (N, 3), cells (M, k) of them, k = 1 or 3, and arrays at the points, as a vtkPolyData."""
    place, made = vtkPoints(), vtkCellArray()
    place.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    ends = np.arange(0, cells.size + 1, cells.shape[1])
    made.SetData(*(numpy_to_vtkIdTypeArray(a.astype(np.int64).ravel(), deep=True) for a in (ends, cells)))
    output.SetPoints(place)
    (output.SetVerts if cells.shape[1] == 1 else output.SetPolys)(made)
    for name, array in arrays.items():
        found = numpy_to_vtk(np.ascontiguousarray(array, np.uint8 if array.dtype == bool else array.dtype), deep=True)
        found.SetName(name)
        output.GetPointData().AddArray(found)


def world(points, origin):
    """Places given from an origin, as world coordinates."""
    return points + np.asarray(origin) if any(origin) else points


def of_views():
    """The proxies of all sources and of all views with a camera, of this process."""
    try:
        from paraview.modules.vtkRemotingServerManager import vtkSMProxyIterator, vtkSMProxyManager
    except ImportError:
        return [], []
    manager = vtkSMProxyManager.GetProxyManager().GetActiveSessionProxyManager()
    found = {"sources": [], "views": []}
    for group, proxies in found.items() if manager else ():
        at = vtkSMProxyIterator()
        at.SetSessionProxyManager(manager)
        at.SetModeToOneGroup()
        at.Begin(group)
        while not at.IsAtEnd():
            proxies.append(at.GetProxy())
            at.Next()
    return found["sources"], [one for one in found["views"] if hasattr(one.GetClientSideObject(), "GetRenderer")]


def shown(it, actor):
    """What shows or hides an actor before each image: as the filter, of which `it` is a weak reference,
    is shown in the view."""
    from paraview.modules.vtkRemotingServerManager import vtkSMPropertyHelper

    def before(renderer, _):
        me, visible = it(), False
        if me is None:  # the filter was deleted
            actor.remove()
            return
        sources, views = of_views()
        source = next((one for one in sources if one.GetClientSideObject() is me), None)
        view = next((one for one in views if one.GetClientSideObject().GetRenderer() is renderer), None)
        if source is not None and view is not None:
            made = view.FindRepresentation(source, 0)
            visible = made is not None and not me.empty and bool(vtkSMPropertyHelper(made, "Visibility").GetAsInt())
        actor.actor.SetVisibility(visible)

    return before
