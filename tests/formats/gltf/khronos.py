"""The Khronos validator of glTF, where `make test-gltf` has installed it."""

import json
import shutil
import subprocess
from pathlib import Path

FOLDER = Path(__file__).parents[3] / "build" / "gltf"
SCRIPT = """
const validator = require('gltf-validator');
const fs = require('fs');
require('readline').createInterface({input: process.stdin}).on('line', async path => {
  const options = {maxIssues: 20};
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)), options);
  const faults = report.issues.messages.filter(each => each.severity === 0);
  const texts = faults.map(each => `${each.code}: ${each.message} (${each.pointer})`);
  console.log(JSON.stringify(texts));
});
"""


class KhronosValidator:
    """Says what is wrong with files, one after another; `is_there` where it can."""

    def __init__(self):
        self._node = shutil.which("node")
        self.is_there = bool(self._node) and (FOLDER / "node_modules/gltf-validator").is_dir()
        self._process = None

    def find_faults(self, path):
        """Return the errors in a `.glb` file; none where the validator is not installed."""
        if not self.is_there:
            return []
        if self._process is None:
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
            self._process = subprocess.Popen([self._node, "-e", SCRIPT], cwd=FOLDER, **pipes)
        self._process.stdin.write(f"{path.resolve()}\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def close(self):
        """End Node.js."""
        if self._process is not None:
            self._process.stdin.close()
            self._process.wait()
            self._process.stdout.close()
