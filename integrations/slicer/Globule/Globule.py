"""3D Slicer module: volumes from tracked ultrasound, live and from files, with globule.

The work is in globule_slicer.py; this file has the panel and the scene's nodes.
"""

import ctk
import globule_slicer as work
import numpy as np
import qt
import slicer
import vtk
from slicer.ScriptedLoadableModule import ScriptedLoadableModule, ScriptedLoadableModuleWidget


class Globule(ScriptedLoadableModule):
    """What Slicer's list of modules shows."""

    def __init__(self, parent):
        ScriptedLoadableModule.__init__(self, parent)
        parent.title = "Globule"
        parent.categories = ["IGT", "Ultrasound"]
        parent.dependencies = []
        parent.contributors = ["The globule authors"]
        parent.helpText = (
            "Reconstructs volumes from tracked freehand ultrasound: live over OpenIGTLink, from "
            "files, and from sequences. Live needs the extension SlicerOpenIGTLink."
        )


class GlobuleWidget(ScriptedLoadableModuleWidget):
    """The panel."""

    def setup(self):
        """Make the panel."""
        ScriptedLoadableModuleWidget.setup(self)
        self.run = self.connector = None
        self.seen = False  # whether the live volume is in the slice views
        self.timer = qt.QTimer()
        self.timer.setInterval(500)
        self.timer.timeout.connect(self.onTick)

        form = self._section("Install")
        self.wheel = ctk.ctkPathLineEdit()
        form.addRow("Wheel (empty: released version)", self.wheel)
        self._button(form, "Install globule", self.onInstall)

        form = self._section("Calibration")
        self.phantom, self.wires, self.more = (ctk.ctkPathLineEdit() for _ in range(3))
        form.addRow("N-wire phantom (.xml, .toml)", self.phantom)
        form.addRow("Sweep of it", self.wires)
        form.addRow("Another sweep, to validate", self.more)
        self._button(form, "Calibrate", self.onCalibrate)

        form = self._section("Live")
        self.images = qt.QLineEdit("igtl://localhost:18944")
        self.tracker = qt.QLineEdit("")
        self.calibration = ctk.ctkPathLineEdit()
        self.record = qt.QLineEdit("")
        self.port = qt.QSpinBox()
        self.port.setRange(1, 65535)
        self.port.value = 18945
        form.addRow("Images from", self.images)
        form.addRow("Tracker from (empty: the same)", self.tracker)
        form.addRow("Calibration", self.calibration)
        form.addRow("Record to a folder", self.record)
        form.addRow("Port for the volume", self.port)
        self.start = self._button(form, "Start", self.onStart)
        self.stop = self._button(form, "Stop", self.onStop)
        self.stop.enabled = False

        form = self._section("File or sequence")
        self.voxelSize = ctk.ctkDoubleSpinBox()
        self.voxelSize.decimals, self.voxelSize.value = 2, 0.5
        self.voxelSize.suffix = " mm"
        self.sweep = ctk.ctkPathLineEdit()
        self.poses = ctk.ctkPathLineEdit()
        self.browser = slicer.qMRMLNodeComboBox()
        self.browser.nodeTypes = ["vtkMRMLSequenceBrowserNode"]
        self.browser.noneEnabled, self.browser.addEnabled = True, False
        self.browser.setMRMLScene(slicer.mrmlScene)
        form.addRow("Voxel size (also live)", self.voxelSize)
        form.addRow("Sweep", self.sweep)
        form.addRow("Pose table (optional)", self.poses)
        self._button(form, "Reconstruct file", self.onFile)
        form.addRow("Sequence browser", self.browser)
        self._button(form, "Reconstruct sequence", self.onSequence)

        self.status = qt.QLabel("")
        self.status.wordWrap = True
        self.layout.addWidget(self.status)
        self.layout.addStretch(1)

    def cleanup(self):
        """Slicer closes the module."""
        self.onStop()

    def onInstall(self):
        """Install globule into Slicer's Python."""
        with slicer.util.tryWithErrorDisplay("globule is not installed", waitCursor=True):
            slicer.util.pip_install(work.requirement(self.wheel.currentPath))
            self.status.text = "globule is installed"

    def onCalibrate(self):
        """Calibrate by an N-wire phantom, show the report, and take the calibration if it may be used."""
        with slicer.util.tryWithErrorDisplay("No calibration", waitCursor=True):
            found = work.calibrate(
                self.phantom.currentPath, self.wires.currentPath, self.more.currentPath,
                slicer.app.temporaryPath, work.slicer_python(slicer.app.slicerHome))  # fmt: skip
            if found.passed:
                self.calibration.currentPath = found.calibration
            self.status.text = found.text
            qt.QDesktopServices.openUrl(qt.QUrl.fromLocalFile(found.report))

    def onStart(self):
        """Start the live reconstruction, and a connector that receives its volume."""
        with slicer.util.tryWithErrorDisplay("Live reconstruction does not start"):
            if not hasattr(slicer.modules, "openigtlinkif"):
                raise RuntimeError("expected the extension SlicerOpenIGTLink, got none")
            settings = work.LiveSettings(
                images=self.images.text, tracker=self.tracker.text,
                voxel_size=self.voxelSize.value, calibration=self.calibration.currentPath,
                port=self.port.value, record=self.record.text,
                output=slicer.app.temporaryPath + "/globule_live.nrrd",
            )  # fmt: skip
            python = work.slicer_python(slicer.app.slicerHome)
            self.run = work.LiveRun(settings, python)
            if self.connector is None:
                self.connector = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLIGTLConnectorNode")
                self.connector.SetName("Globule")
            self.connector.SetTypeClient("localhost", settings.port)
            self.connector.Start()
            self.seen = False
            self.start.enabled, self.stop.enabled = False, True
            self.timer.start()

    def onStop(self):
        """End the live reconstruction."""
        self.timer.stop()
        if self.connector is not None:
            self.connector.Stop()
        if self.run is not None:
            self.status.text = self.run.stop()
            self.run = None
        self.start.enabled, self.stop.enabled = True, False

    def onTick(self):
        """Show the counts, and the volume as soon as it is there; notice an end."""
        volume = slicer.mrmlScene.GetFirstNodeByName("Volume")
        if volume is not None and volume.IsA("vtkMRMLScalarVolumeNode") and not self.seen:
            slicer.util.setSliceViewerLayers(background=volume, fit=True)
            self.seen = True
        counts = slicer.mrmlScene.GetFirstNodeByName("Counts")
        if counts is not None and counts.IsA("vtkMRMLTextNode"):
            self.status.text = counts.GetText()
        if self.run is not None and not self.run.running:
            self.onStop()

    def onFile(self):
        """Reconstruct a file."""
        with slicer.util.tryWithErrorDisplay("No volume", waitCursor=True):
            self._add(work.reconstruct_file(
                self.sweep.currentPath, self.voxelSize.value, self.calibration.currentPath,
                self.poses.currentPath))  # fmt: skip

    def onSequence(self):
        """Reconstruct the images of a sequence browser, at the poses that their nodes have."""
        with slicer.util.tryWithErrorDisplay("No volume", waitCursor=True):
            browser = self.browser.currentNode()
            if browser is None:
                raise ValueError("expected a sequence browser, got none")
            frames, poses = self._frames(browser)
            self._add(work.reconstruct_frames(frames, poses, self.voxelSize.value))

    def _frames(self, browser):
        """Images and RAS from pixel of each item."""
        proxies = vtk.vtkCollection()
        browser.GetAllProxyNodes(proxies)
        nodes = [proxies.GetItemAsObject(i) for i in range(proxies.GetNumberOfItems())]
        images = [node for node in nodes if node.IsA("vtkMRMLScalarVolumeNode")]
        if not images:
            raise ValueError("expected a sequence of images, got none")
        frames, poses = [], []
        for i in range(browser.GetNumberOfItems()):
            browser.SetSelectedItemNumber(i)
            matrix, world = vtk.vtkMatrix4x4(), vtk.vtkMatrix4x4()
            images[0].GetIJKToRASMatrix(matrix)
            parent = images[0].GetParentTransformNode()
            if parent is not None:
                parent.GetMatrixTransformToWorld(world)
            vtk.vtkMatrix4x4.Multiply4x4(world, matrix, matrix)
            frames.append(np.array(slicer.util.arrayFromVolume(images[0])[0]))
            poses.append(slicer.util.arrayFromVTKMatrix(matrix))
        return frames, poses

    def _add(self, shown):
        """Volume and trust map as nodes of the scene."""
        for name, values in (("Ultrasound", shown.values), ("Trust", shown.trust)):
            label = "vtkMRMLLabelMapVolumeNode" if name == "Trust" else "vtkMRMLScalarVolumeNode"
            node = slicer.util.addVolumeFromArray(values, ijkToRAS=shown.ras_from_voxel, name=name, nodeClassName=label)
            if name == "Ultrasound":
                slicer.util.setSliceViewerLayers(background=node, fit=True)
        self.status.text = shown.text

    def _section(self, title):
        box = ctk.ctkCollapsibleButton()
        box.text = title
        self.layout.addWidget(box)
        return qt.QFormLayout(box)

    def _button(self, form, text, slot):
        button = qt.QPushButton(text)
        button.clicked.connect(slot)
        form.addRow(button)
        return button
