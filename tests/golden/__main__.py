"""Write all files of this folder anew."""

from tests.golden.meshes import FILES, FOLDER

for name, lines in FILES.items():
    (FOLDER / name).write_text("".join(f"{line}\n" for line in lines()))
