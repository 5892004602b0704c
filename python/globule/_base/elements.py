"""Chemical elements: symbols, van der Waals radii and colors."""

from __future__ import annotations

# Symbol, van der Waals radius in Å (Bondi 1964; else Alvarez 2013), color of Jmol in sRGB.
_TABLE = """
H 1.20 ffffff, He 1.40 d9ffff, Li 1.82 cc80ff, Be 1.53 c2ff00, B 1.92 ffb5b5, C 1.70 909090,
N 1.55 3050f8, O 1.52 ff0d0d, F 1.47 90e050, Ne 1.54 b3e3f5, Na 2.27 ab5cf2, Mg 1.73 8aff00,
Al 1.84 bfa6a6, Si 2.10 f0c8a0, P 1.80 ff8000, S 1.80 ffff30, Cl 1.75 1ff01f, Ar 1.88 80d1e3,
K 2.75 8f40d4, Ca 2.31 3dff00, Sc 2.58 e6e6e6, Ti 2.46 bfc2c7, V 2.42 a6a6ab, Cr 2.45 8a99c7,
Mn 2.45 9c7ac7, Fe 2.44 e06633, Co 2.40 f090a0, Ni 1.63 50d050, Cu 1.40 c88033, Zn 1.39 7d80b0,
Ga 1.87 c28f8f, Ge 2.11 668f8f, As 1.85 bd80e3, Se 1.90 ffa100, Br 1.85 a62929, Kr 2.02 5cb8d1,
Rb 3.03 702eb0, Sr 2.49 00ff00, Y 2.75 94ffff, Zr 2.52 94e0e0, Nb 2.56 73c2c9, Mo 2.45 54b5b5,
Tc 2.44 3b9e9e, Ru 2.46 248f8f, Rh 2.44 0a7d8c, Pd 1.63 006985, Ag 1.72 c0c0c0, Cd 1.58 ffd98f,
In 1.93 a67573, Sn 2.17 668080, Sb 2.06 9e63b5, Te 2.06 d47a00, I 1.98 940094, Xe 2.16 429eb0,
Cs 3.43 57178f, Ba 2.49 00c900, La 2.98 70d4ff, Ce 2.88 ffffc7, Pr 2.92 d9ffc7, Nd 2.95 c7ffc7,
Pm 2.90 a3ffc7, Sm 2.90 8fffc7, Eu 2.87 61ffc7, Gd 2.83 45ffc7, Tb 2.79 30ffc7, Dy 2.87 1fffc7,
Ho 2.81 00ff9c, Er 2.83 00e675, Tm 2.79 00d452, Yb 2.80 00bf38, Lu 2.74 00ab24, Hf 2.63 4dc2ff,
Ta 2.53 4da6ff, W 2.57 2194d6, Re 2.49 267dab, Os 2.48 266696, Ir 2.41 175487, Pt 1.75 d0d0e0,
Au 1.66 ffd123, Hg 1.55 b8b8d0, Tl 1.96 a6544d, Pb 2.02 575961, Bi 2.07 9e4fb5, Po 1.97 ab5c00,
At 2.02 754f45, Rn 2.20 428296, Fr 3.48 420066, Ra 2.83 007d00, Ac 2.80 70abfa, Th 2.93 00baff,
Pa 2.88 00a1ff, U 1.86 008fff, Np 2.82 0080ff, Pu 2.81 006bff, Am 2.83 545cf2, Cm 3.05 785ce3
"""


def _rows() -> dict[str, tuple[int, float, str]]:
    found = {}
    for number, row in enumerate(_TABLE.replace("\n", " ").split(","), 1):
        symbol, radius, color = row.split()
        found[symbol] = number, float(radius), color
    return found


ELEMENTS = _rows()
ELEMENTS |= {"D": ELEMENTS["H"], "T": ELEMENTS["H"]}  # isotopes
