# SPDX-License-Identifier: Apache-2.0
"""Asks `haarlight serve` for pictures; Python's own library, NumPy only for arrays.

    from serve_client import Relight
    lab = Relight("http://127.0.0.1:8482")
    png = lab.picture("airplane", lights={528: 1.0, 33: 0.5})
    sky = lab.add_sky("sky.hdr")
    floats = lab.array("airplane", sky=sky, rotate=30)      # (height, width, channels), linear
    print(lab.told["error_bound"])
"""

import http.client
import json
import pathlib
import urllib.parse


class Relight:
    def __init__(self, url, token=None):
        self.address = urllib.parse.urlsplit(url).netloc
        self.headers = {"Authorization": f"Bearer {token}"} if token else {}
        self.connection = None
        self.told = {}  # of the last picture: error_bound, terms, exposure, ...

    def ask(self, method, path, body=None):
        """The answer's bytes. One connection for all requests; it is opened again when it was closed."""
        for is_last in (self.connection is None, True):
            self.connection = self.connection or http.client.HTTPConnection(self.address, timeout=60)
            try:
                self.connection.request(method, path, body, self.headers)
                answer = self.connection.getresponse()
                content = answer.read()
                break
            except (ConnectionError, http.client.BadStatusLine):
                self.connection.close()
                self.connection = None
                if is_last:
                    raise
        if answer.status >= 400:
            error = json.loads(content)["error"]
            raise RuntimeError(f"{answer.status}: {error['what']} ({error['where']}): {error['cure']}")
        self.told = json.loads(answer.headers.get("Haarlight-Picture", "{}"))
        return content

    def add_sky(self, path):
        return json.loads(self.ask("POST", "/v1/skies", pathlib.Path(path).read_bytes()))["sky"]

    def picture(self, basis, kind="png", lights=None, weights=None, **query):
        """`lights`: {number: weight}; `weights`: a number or [r, g, b] for every light; or sky="..."."""
        if lights is not None:
            query["lights"] = ",".join(f"{light}={weight!r}" for light, weight in lights.items())
        path = f"/v1/bases/{urllib.parse.quote(basis)}/picture.{kind}?{urllib.parse.urlencode(query)}"
        return self.ask("GET", path) if weights is None else self.ask("POST", path, json.dumps(weights))

    def array(self, basis, **light):
        import numpy
        values = numpy.frombuffer(self.picture(basis, "f32", **light), "<f4")
        return values.reshape(self.told["height"], self.told["width"], self.told["channels"])
