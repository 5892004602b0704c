"""What the module for 3D Slicer calls of Slicer, Qt and CTK, and nothing else: widgets that hold what is
set, and a scene whose nodes hold images and matrices as VTK has them."""

import contextlib
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np


class Signal:
    def __init__(self):
        self.slots = []

    def connect(self, slot):
        self.slots.append(slot)

    def emit(self):
        for slot in self.slots:
            slot()


class Widget:
    """A widget; only the named properties can be set."""

    names: tuple[str, ...] = ()

    def __init__(self, text=""):
        self.__dict__.update({name: None for name in self.names}, text=text, enabled=True)

    def __setattr__(self, name, value):
        if name not in (*self.names, "text", "enabled"):
            raise AttributeError(f"{type(self).__name__} has no {name}")
        self.__dict__[name] = value


class PathLineEdit(Widget):
    names = ("currentPath",)

    def __init__(self):
        super().__init__()
        self.currentPath = ""


class SpinBox(Widget):
    names = ("value", "decimals", "suffix")

    def setRange(self, least, most):
        assert least < most


class Label(Widget):
    names = ("wordWrap",)


class Button(Widget):
    def __init__(self, text=""):
        super().__init__(text)
        self.__dict__["clicked"] = Signal()


class Timer:
    def __init__(self):
        self.timeout, self.on = Signal(), False

    def setInterval(self, milliseconds):
        assert milliseconds > 0

    def start(self):
        self.on = True

    def stop(self):
        self.on = False


class NodeComboBox(Widget):
    names = ("nodeTypes", "noneEnabled", "addEnabled", "node")

    def setMRMLScene(self, scene):
        assert isinstance(scene, Scene)

    def currentNode(self):
        return self.node


class Node:
    """A node of the scene: a kind, and what it holds."""

    def __init__(self, kind, name="", **held):
        self.kind, self.name = kind, name
        self.__dict__.update(held)

    def IsA(self, kind):
        return kind == self.kind or (kind == "vtkMRMLScalarVolumeNode" and self.kind == "vtkMRMLLabelMapVolumeNode")


class Image(Node):
    """An image, and its place: of its own, and of the transform that it is under."""

    def GetIJKToRASMatrix(self, matrix):
        matrix.DeepCopy(self.ras_from_ijk.ravel())

    def GetParentTransformNode(self):
        return self.parent


class Transform(Node):
    def GetMatrixTransformToWorld(self, matrix):
        matrix.DeepCopy(self.world.ravel())


class Browser(Node):
    """A sequence browser whose image and transform change with the selected item."""

    def GetAllProxyNodes(self, collection):
        for node in (self.transform, self.image):
            collection.AddItem(node)

    def GetNumberOfItems(self):
        return len(self.images)

    def SetSelectedItemNumber(self, i):
        self.image.values, self.transform.world = self.images[i], self.worlds[i]


class Connector(Node):
    def SetName(self, name):
        self.name = name

    def SetTypeClient(self, host, port):
        self.address = host, port

    def Start(self):
        self.on = True

    def Stop(self):
        self.on = False


class Scene:
    def __init__(self):
        self.nodes = []

    def AddNewNodeByClass(self, kind):
        assert kind == "vtkMRMLIGTLConnectorNode"
        self.nodes.append(Connector(kind))
        return self.nodes[-1]

    def GetFirstNodeByName(self, name):
        return next((node for node in self.nodes if node.name == name), None)


class Form:
    def __init__(self, box):
        self.rows = []

    def addRow(self, *row):
        self.rows.append(row)


class Layout:
    def addWidget(self, widget):
        assert isinstance(widget, Widget)

    def addStretch(self, share):
        pass


class Module:
    def __init__(self, parent):
        self.parent = parent


class ModuleWidget:
    def __init__(self):
        self.layout = Layout()

    def setup(self):
        pass


def installed(monkeypatch, folder: Path):
    """Put the stub in place of Slicer; what it shows and does is in the returned object."""
    import vtk

    seen = SimpleNamespace(errors=[], background=None, pip=[], opened=[], buttons={}, scene=Scene())

    class Collection:
        """Of nodes that are no objects of VTK."""

        def __init__(self):
            self.items = []

        def AddItem(self, item):
            self.items.append(item)

        def GetNumberOfItems(self):
            return len(self.items)

        def GetItemAsObject(self, i):
            return self.items[i]

    @contextlib.contextmanager
    def try_with_error_display(message, show=True, waitCursor=False):
        try:
            yield
        except Exception as error:
            seen.errors.append(f"{message}: {error}")

    def add_volume(array, ijkToRAS=None, name=None, nodeClassName=None):
        seen.scene.nodes.append(Image(nodeClassName, name, values=array, ras_from_ijk=np.array(ijkToRAS), parent=None))
        return seen.scene.nodes[-1]

    def array_from_matrix(matrix):
        return np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])

    def set_layers(background=None, fit=False):
        seen.background = background

    class PushButton(Button):
        def __init__(self, text=""):
            super().__init__(text)
            seen.buttons[text] = self

    util = SimpleNamespace(
        pip_install=seen.pip.append, tryWithErrorDisplay=try_with_error_display, setSliceViewerLayers=set_layers,
        addVolumeFromArray=add_volume, arrayFromVolume=lambda node: node.values, arrayFromVTKMatrix=array_from_matrix,
    )  # fmt: skip
    home = folder / "slicer"
    (home / "bin").mkdir(parents=True)
    (home / "bin" / "PythonSlicer").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    (home / "bin" / "PythonSlicer").chmod(0o755)
    modules = {
        "slicer": {"util": util, "mrmlScene": seen.scene, "qMRMLNodeComboBox": NodeComboBox,
                   "modules": SimpleNamespace(openigtlinkif=None),
                   "app": SimpleNamespace(temporaryPath=str(folder), slicerHome=str(home))},
        "slicer.ScriptedLoadableModule": {"ScriptedLoadableModule": Module,
                                          "ScriptedLoadableModuleWidget": ModuleWidget},
        "qt": {"QTimer": Timer, "QLineEdit": Widget, "QSpinBox": SpinBox, "QLabel": Label, "QPushButton": PushButton,
               "QFormLayout": Form, "QUrl": SimpleNamespace(fromLocalFile=lambda path: f"file://{path}"),
               "QDesktopServices": SimpleNamespace(openUrl=seen.opened.append)},
        "ctk": {"ctkPathLineEdit": PathLineEdit, "ctkDoubleSpinBox": SpinBox, "ctkCollapsibleButton": Widget},
        "vtk": {"vtkMatrix4x4": vtk.vtkMatrix4x4, "vtkCollection": Collection},
    }  # fmt: skip
    for name, held in modules.items():
        module = ModuleType(name)
        module.__dict__.update(held)
        monkeypatch.setitem(sys.modules, name, module)
    return seen
