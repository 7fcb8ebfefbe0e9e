// SPDX-License-Identifier: Apache-2.0
// Pages in one texture array, one after another: texel a of all is at column a % 1024, row
// a / 1024 % 256 of layer a / 2^18, so that any run of pages is uploaded in a few rectangles.

export const kColumnBits = 10;
export const kLayerBits = 18;
const kColumns = 1 << kColumnBits;
const kRows = 1 << (kLayerBits - kColumnBits);
const kLayerTexels = 1 << kLayerBits;
const kFirstLayers = 4;

/** The memory that pages may take, of the page's limit and the graphics processor's. */
export class Budget {
  constructor(bytes) {
    this.left = bytes;
  }

  take(bytes) {
    if (bytes > this.left) {
      throw new FullError();
    }
    this.left -= bytes;
  }
}

/** No room for more pages. */
export class FullError extends Error {}

const kFormats = {
  int8: gl => ({internal: gl.RGBA8I, format: gl.RGBA_INTEGER, type: gl.BYTE, bytes: 4, View: Int8Array}),
  int16: gl => ({internal: gl.RGBA16I, format: gl.RGBA_INTEGER, type: gl.SHORT, bytes: 8, View: Int16Array}),
  half: gl => ({internal: gl.RGBA16F, format: gl.RGBA, type: gl.HALF_FLOAT, bytes: 8, View: Uint16Array}),
};

export class PageStore {
  /** @param kind  int8, int16 or half; @param texels  of a page */
  constructor(gl, kind, texels, budget) {
    Object.assign(this, {gl, texels, budget}, kFormats[kind](gl));
    this.isInteger = kind !== 'half';
    this.n = 0;
    this.layers = 0;
    this.texture = this.make(1, 1, 1);  // something to bind, until there are pages
    this.mostLayers = gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS);
  }

  make(columns, rows, layers) {
    const {gl} = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, this.internal, columns, rows, layers);
    if (gl.getError() === gl.OUT_OF_MEMORY) {
      gl.deleteTexture(texture);
      throw new FullError();
    }
    return texture;
  }

  /** A texture of so many layers, paid for. */
  buy(layers) {
    this.budget.take((layers - this.layers) * kLayerTexels * this.bytes);
    return this.make(kColumns, kRows, layers);
  }

  /** Makes room by a texture twice as large. */
  grow(layersNeeded) {
    const {gl} = this;
    let layers = Math.min(Math.max(layersNeeded, 2 * this.layers, kFirstLayers), this.mostLayers);
    if (layersNeeded > layers) {
      throw new FullError();
    }
    let larger;
    try {
      larger = this.buy(layers);
    } catch (error) {
      if (!(error instanceof FullError) || layers === layersNeeded) {
        throw error;
      }
      layers = layersNeeded;  // as large as must be, then
      larger = this.buy(layers);
    }
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, frame);
    const used = Math.ceil(this.n * this.texels / kLayerTexels);
    for (let layer = 0; layer < used; ++layer) {
      gl.framebufferTextureLayer(gl.READ_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, this.texture, 0, layer);
      gl.copyTexSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, 0, 0, kColumns, kRows);
    }
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
    gl.deleteTexture(this.texture);
    this.texture = larger;
    this.layers = layers;
  }

  /** Uploads n pages that stand at `offset` of `buffer`. @return  the first one's number */
  add(buffer, offset, n) {
    const {gl} = this;
    const first = this.n;
    const end = (first + n) * this.texels;
    const needed = Math.ceil(end / kLayerTexels);
    if (needed > this.layers) {
      this.grow(needed);
    }
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const values = new this.View(buffer, offset);
    let from = 0;
    const put = (texel, width, height) => {
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, texel % kColumns, Math.floor(texel / kColumns) % kRows,
                       Math.floor(texel / kLayerTexels), width, height, 1, this.format, this.type,
                       values, from);
      from += 4 * width * height;
      return texel + width * height;
    };
    for (let texel = first * this.texels; texel < end;) {
      const column = texel % kColumns;
      const left = end - texel;
      if (column !== 0 || left < kColumns) {
        texel = put(texel, Math.min(kColumns - column, left), 1);
      } else {
        const row = Math.floor(texel / kColumns) % kRows;
        texel = put(texel, kColumns, Math.min(Math.floor(left / kColumns), kRows - row));
      }
    }
    this.n += n;
    return first;
  }
}
