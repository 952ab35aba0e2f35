"""Optional rooms, which a first reader need not know; the command line and `simgap.api` alone import them.

`wizard`: a case for a new robot. `certify`: a certificate for the checker. `next`: the recording to make next. `paper`:
the paper's own numbers. `engines`: engines beyond PyBullet and MuJoCo.
"""
