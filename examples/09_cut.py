"""A brain from a tomography, one metaball per voxel, cut open; and the voxel at a pixel.

Writes cut.png. With nilearn the brain is the MNI152 template, else a phantom made by formulas. With
a file of your own:
    globule render head.nii.gz -o cut.png --preset tissue --up 0,0,1 --clip-box 0,-999,5,999,999,999
"""

import sys
from pathlib import Path

import globule as gb

sys.path.append(str(Path(__file__).resolve().parents[1]))  # the repository, for its phantom
from bench.figures.anatomy import metaballs, tomography

values, world_from_voxel, name = tomography(resolution=2)
scene = gb.Scene(metaballs(values, world_from_voxel))  # mm, z to the head
print(f"{name}: {len(scene):,} metaballs")

camera = gb.Camera(eye=(310, 300, 230), look_at=(0, -18, 2), up=(0, 0, 1), fov=21)
slab = gb.ClipBox(lo=(0, -999, 5), hi=(999, 999, 999))  # ClipPlane and ClipSphere, too
ball = gb.ClipSphere(center=(0, 55, 5), radius=18)
settings = gb.load_preset("tissue", scene, up=(0, 0, 1))
frame = gb.render(scene, camera, (480, 420), settings, clips=[slab, ball])
frame.save("cut.png")

seen = frame.pick(300, 160)  # column, row
if seen:
    x, y, z = seen.position
    print(f"pixel 300,160 shows {x:.1f}, {y:.1f}, {z:.1f} mm, voxel {seen.particle:,}")
    on_cut = (abs(seen.normal) == 1).any()  # a capped face has the cut's own normal
    print("on the cut face" if on_cut else "on the surface")
