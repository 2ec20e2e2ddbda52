"""Turn a mesh animation into a cage animation.

The method is that of Savoye and Franco, *CageIK: Dual-Laplacian Cage-Based
Inverse Kinematics*, AMDO 2010. The command-line tool is `cageik`; the modules
of this package are what it calls.
"""

__version__ = "0.1.0"
