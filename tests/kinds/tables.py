"""Tables of text, packed ones too."""

import bz2
import gzip
import lzma

import numpy as np

from kinds.base import CENTERS, FRAMES, RADII, N, X, grains, kind, numbered, rows, text, with_radii

text("ParaView table", "a.csv", '"Points:0","Points:1","Points:2"\n' + rows(X, ","))
text("pandas with its index", "a.csv", ",x,y,z\n" + numbered(X, ","))
text("R write.csv", "a.csv", '"","x","y","z"\n' + numbered(X, ","))
text("DualSPHysics CSV", "a.csv",
     "Pos.x [m];Pos.y [m];Pos.z [m];Idp;Rhop [kg/m^3]\n" + rows(X, ";", after=";7;1000"),
     unit="m", names=("Rhop",))  # fmt: skip
text("Excel in German", "a.csv", "\ufeffx;y;z\r\n" + rows(X, ";").replace(".", ","))
text("Excel Unicode text", "a.txt", "\ufeffX\tY\tZ\r\n" + rows(X, "\t"), "utf-16")
text("EDEM radii", "a.csv", "Particle Radius (m),X (m),Y (m),Z (m)\n"
     + "".join(f"{r:.6f},{row}\n" for r, row in zip(RADII, rows(CENTERS, ",").splitlines(), strict=True)),
     **grains(names=("Particle Radius",)), unit="m")  # fmt: skip
text("OpenFOAM cloud", "a.csv", "Points:0,Points:1,Points:2,d,origProcId\n"
     + "".join(f"{row},0\n" for row in with_radii(",", 2.0).splitlines()), **grains(names=("d",)))  # fmt: skip
text("STAR-CCM+ table", "a.csv",
     '"Pressure (Pa)","X (m)","Y (m)","Z (m)"\n' + rows(X, ",", "1.0,"),
     unit="m", names=("Pressure",))  # fmt: skip
text("CFD-Post export", "a.csv",
     "[Name]\nfluid\n\n[Data]\nX [ m ], Y [ m ], Z [ m ], Pressure [ Pa ]\n"
     + rows(X, ", ", after=", 1.0"), unit="m", names=("Pressure",))  # fmt: skip
text("EDEM export", "a.csv",
     "EXTRACTED DATA:\nTIME: 0.1\nParticle ID, Position X (m), Position Y (m), Position Z (m)\n"
     + numbered(X, ", "), unit="m")  # fmt: skip
text("COMSOL export", "a.txt",
     "% Model:              run.mph\n% Dimension:          3\n"
     "% x                       y                        z\n" + rows(X, "       "))  # fmt: skip
text("numpy.savetxt", "a.txt", "# x y z\n" + rows(X))
text("gnuplot data", "a.dat", "# time 0.1\n# x y z\n" + rows(X) + "\n\n")
text("CloudCompare ASCII", "a.txt", "//X Y Z R G B\n" + rows(X, after=" 255 0 0"))
text("MeshLab XYZ with normals", "a.xyz", rows(X, after=" 0.0 0.0 1.0"))
text("scanner's PTS", "a.pts", f"{N}\n" + rows(X, after=" -1033 12 34 56"), names=("intensity",))
text("Yade", "a.txt", "#format x_y_z_r\n# periodic\n" + with_radii(), **grains(names=("radius",)))
text("table of grains", "a.csv", "x,y,z,radius\n" + with_radii(","), **grains(names=("radius",)))
kind("packed table", "a.csv.gz")(lambda path: path.write_bytes(gzip.compress(b"x,y,z\n" + rows(X, ",").encode())))
kind("bzip2 table", "a.xyz.bz2")(lambda path: path.write_bytes(bz2.compress(rows(X).encode())))
kind("xz table", "a.csv.xz")(lambda path: path.write_bytes(lzma.compress(b"x,y,z\n" + rows(X, ",").encode())))
text("Rocky DEM", "a.csv", "Particle ID,Particle X-Coordinate [m],Particle Y-Coordinate [m],Particle Z-Coordinate [m],"
     "Particle Equivalent Diameter [mm]\n" + numbered(np.column_stack([CENTERS, 2000 * RADII]), ","),
     **grains(names=("Particle Equivalent Diameter",)), unit="m",
     warns="Particle Equivalent Diameter is in mm and becomes m, as x is")  # fmt: skip
text("STAR-CCM+ parcels", "a.csv", '"Parcel Centroid[X] (m)","Parcel Centroid[Y] (m)","Parcel Centroid[Z] (m)",'
     '"Particle Diameter (m)"\n' + with_radii(",", 2.0), **grains(names=("Particle Diameter",)), unit="m")  # fmt: skip
text("PFC balls", "a.csv", "id,pos-x,pos-y,pos-z,ball.radius\n"
     + numbered(np.column_stack([CENTERS, RADII]), ","), **grains(names=("ball.radius",)))  # fmt: skip
text("DEM with a short word", "a.txt", "x y z r\n" + with_radii(), **grains(names=("r",)))
text("survey in UTM zones", "a.csv", "Easting [m],Northing [m],Elevation [m]\n" + rows(X, ","), unit="m")
text("ids without names", "a.txt", numbered(X), names=("id",), warns="taken as id, x, y, z")
text("ids and types without names", "a.csv",
     "".join(f"{i};2;{row}\n" for i, row in enumerate(rows(X, ";").splitlines(), 7)),
     names=("id", "type"), warns="taken as id, type, x, y, z")  # fmt: skip
_TRACKS = [f"{k},{i},{row}\n" for k, x in enumerate(FRAMES) for i, row in enumerate(rows(x, ",").splitlines())]
text("tracks by frame", "a.csv", "Time [s],id,x,y,z\n" + "".join(_TRACKS), frames=2, names=("Time", "id"))
text("tracks by particle", "a.csv", "frame,particle,x,y,z\n" + "".join(sorted(_TRACKS, key=lambda t: t.split(",")[1])),
     frames=2, names=("frame", "particle"))  # fmt: skip
text("frames after each other", "a.txt",
     "# step x y z\n" + "".join(rows(x, before=f"{10 * k} ") for k, x in enumerate(FRAMES)),
     frames=2, names=("step",))  # fmt: skip
text("elevations", "a.csv", "POINT_X,POINT_Y,Elevation\n" + rows(X, ","))
text("units behind names", "a.csv", "x_m,y_m,z_m,radius_mm\n" + "".join(
     f"{row},{1000 * r:.6f}\n" for r, row in zip(RADII, rows(CENTERS, ",").splitlines(), strict=True)),
     **grains(names=("radius_mm",)), unit="m", warns="radius_mm is in mm and becomes m, as x is")  # fmt: skip
