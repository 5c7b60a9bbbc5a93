// Functions of the cell's state as hrl_comfort.studio.web's `trace` and `arrays` wrote them, evaluated in double precision.

const size = (shape) => shape.reduce((product, count) => product * count, 1);
const array = (shape, data) => ({ shape, data });
const scalar = (value) => array([], [Number(value)]);
const lift = (value) => (typeof value === "object" ? value : scalar(value));
const same = (a, b) => a.length === b.length && a.every((length, axis) => length === b[axis]);
const axisOf = (axis, x) => (axis < 0 ? axis + x.shape.length : axis);

/** Apply `f` to each element. */
const map = (f) => (x) => array(x.shape, Array.from(x.data, f));

/** Apply `f` to the elements of some values broadcast together. */
const zip =
  (f) =>
  (...given) => {
    const values = given.map(lift), most = values.reduce((widest, x) => (x.data.length > widest.data.length ? x : widest));
    if (values.every((x) => (x.shape.length <= most.shape.length && x.data.length === 1) || same(x.shape, most.shape))) {
      // All of one shape, or single numbers.
      const data = new Array(most.data.length), [a, b = a, c = a] = values.map((x) => x.data);
      const [i, j, k] = [a, b, c].map((list) => Number(list.length > 1));
      for (let index = 0; index < data.length; index++) data[index] = f(a[i * index], b[j * index], c[k * index]);
      return array(most.shape, data);
    }
    const rank = Math.max(...values.map((x) => x.shape.length));
    const padded = values.map((x) => [...Array(rank - x.shape.length).fill(1), ...x.shape]);
    const shape = Array.from({ length: rank }, (_, axis) => Math.max(...padded.map((own) => own[axis])));
    const data = new Array(size(shape));
    for (let index = 0; index < data.length; index++) {
      const elements = values.map((x, k) => {
        let rest = index, at = 0, stride = 1;
        for (let axis = rank - 1; axis >= 0; axis--) {
          const place = rest % shape[axis];
          rest = (rest - place) / shape[axis];
          if (padded[k][axis] > 1) at += place * stride;
          stride *= padded[k][axis];
        }
        return x.data[at];
      });
      data[index] = f(...elements);
    }
    return array(shape, data);
  };

/** Return the elements whose places along `axis` are `places`. */
function take(x, axis, places) {
  const inner = size(x.shape.slice(axis + 1)), outer = size(x.shape.slice(0, axis)), data = [];
  for (let row = 0; row < outer; row++)
    for (const place of places)
      for (let k = 0; k < inner; k++) data.push(x.data[(row * x.shape[axis] + place) * inner + k]);
  return array([...x.shape.slice(0, axis), places.length, ...x.shape.slice(axis + 1)], data);
}

const range = (from, to, step = 1) => Array.from({ length: Math.max(0, Math.ceil((to - from) / step)) }, (_, k) => from + k * step);

/** Return `f` of each list of elements along an axis, which is no more. */
function lists(f, x, axis) {
  const count = x.shape[axis], inner = size(x.shape.slice(axis + 1)), data = new Array(x.data.length / count);
  for (let row = 0; row < data.length; row++) {
    const list = new Array(count), first = Math.floor(row / inner) * count * inner + (row % inner);
    for (let place = 0; place < count; place++) list[place] = x.data[first + place * inner];
    data[row] = f(list);
  }
  return array(x.shape.filter((_, k) => k !== axis), data);
}

/** Reduce along an axis or some, all of them by default, with `f` of a list of elements. */
const reduce =
  (f) =>
  (x, given = [], keep = false) => {
    const axes = [given ?? []].flat();
    if (axes.length === 1 && !keep) return lists(f, x, axisOf(axes[0], x));
    const chosen = (axes.length ? axes : range(0, x.shape.length)).map((axis) => axisOf(axis, x)).sort((a, b) => b - a);
    const kept = range(0, x.shape.length).filter((axis) => !chosen.includes(axis));
    const moved = ops.permute(x, [...kept, ...chosen]);
    const count = size(chosen.map((axis) => x.shape[axis]));
    const data = range(0, x.data.length / count).map((row) => f(moved.data.slice(row * count, (row + 1) * count)));
    const shape = x.shape.map((length, axis) => (chosen.includes(axis) ? 1 : length));
    return array(keep ? shape : kept.map((axis) => x.shape[axis]), data);
  };

/** Replace each list of elements along an axis by a list of as many. */
const along = (f) => (x, [dim]) => {
  const axis = axisOf(dim, x), count = x.shape[axis], inner = size(x.shape.slice(axis + 1)), data = new Array(x.data.length);
  for (let first = 0; first < data.length; first += count * inner)
    for (let k = 0; k < inner; k++) f(range(0, count).map((place) => x.data[first + place * inner + k])).forEach((value, place) => (data[first + place * inner + k] = value));
  return array(x.shape, data);
};

const reshaped = (x, shape) => {
  const missing = x.data.length / Math.abs(size(shape));
  return array(shape.map((length) => (length === -1 ? missing : length)), x.data);
};

const ops = {
  same: (x) => x,
  getitem: (list, index) => list[index],
  sin: map(Math.sin), cos: map(Math.cos), tanh: map(Math.tanh), abs: map(Math.abs), neg: map((a) => -a),
  sqrt: map(Math.sqrt), exp: map(Math.exp), floor: map(Math.floor), relu: map((a) => Math.max(a, 0)),
  logical_not: map((a) => Number(!a)), bitwise_not: map((a) => Number(!a)),
  add: zip((a, b) => a + b), sub: zip((a, b) => a - b), mul: zip((a, b) => a * b), div: zip((a, b) => a / b),
  remainder: zip((a, b) => a - b * Math.floor(a / b)),
  maximum: zip((a, b) => (a > b ? a : b)), minimum: zip((a, b) => (a < b ? a : b)),
  eq: zip((a, b) => Number(a === b)), ne: zip((a, b) => Number(a !== b)),
  lt: zip((a, b) => Number(a < b)), le: zip((a, b) => Number(a <= b)),
  gt: zip((a, b) => Number(a > b)), ge: zip((a, b) => Number(a >= b)),
  bitwise_and: zip((a, b) => Number(a && b)), logical_and: zip((a, b) => Number(a && b)),
  bitwise_or: zip((a, b) => Number(a || b)), logical_or: zip((a, b) => Number(a || b)),
  where: zip((chosen, a, b) => (chosen ? a : b)),
  clamp: (x, low = null, high = null) => map((a) => Math.min(Math.max(a, low ?? -Infinity), high ?? Infinity))(x),
  scalar_tensor: scalar,
  arange: (from, to, step) => (to === undefined ? ops.arange(0, from) : array([Math.ceil((to - from) / (step ?? 1))], range(from, to, step ?? 1))),
  full: (shape, value) => array(shape, Array(size(shape)).fill(Number(value))),
  full_like: (x, value) => ops.full(x.shape, value),
  cat(parts, dim = 0) {
    const axis = axisOf(dim, parts[0]), outer = size(parts[0].shape.slice(0, axis)), data = [];
    for (let row = 0; row < outer; row++)
      for (const { data: own } of parts) data.push(...own.slice((row * own.length) / outer, ((row + 1) * own.length) / outer));
    const shape = [...parts[0].shape];
    shape[axis] = parts.reduce((sum, part) => sum + part.shape[axis], 0);
    return array(shape, data);
  },
  slice(x, dim = 0, from = 0, to = Infinity, step = 1) {
    const axis = axisOf(dim, x), length = x.shape[axis];
    const bound = (place) => Math.min(place < 0 ? place + length : place, length);
    return take(x, axis, range(bound(from ?? 0), bound(to ?? Infinity), step));
  },
  select(x, dim, place) {
    const axis = axisOf(dim, x), found = take(x, axis, [place < 0 ? place + x.shape[axis] : place]);
    return array(found.shape.filter((_, k) => k !== axis), found.data);
  },
  index: (x, given) => {
    const axis = given.length - 1, places = given[axis], found = take(x, axis, places.data);
    return array([...x.shape.slice(0, axis), ...places.shape, ...x.shape.slice(axis + 1)], found.data);
  },
  index_select: (x, dim, places) => take(x, axisOf(dim, x), places.data),
  gather(x, dim, places) {
    const axis = axisOf(dim, x), strides = (shape) => shape.map((_, k) => size(shape.slice(k + 1)));
    const own = strides(places.shape), theirs = strides(x.shape);
    const data = Array.from(places.data, (place, index) =>
      x.data[own.reduce((at, stride, k) => at + theirs[k] * (k === axis ? place : Math.floor(index / stride) % places.shape[k]), 0)]);
    return array(places.shape, data);
  },
  split_with_sizes(x, sizes, dim = 0) {
    let from = 0;
    return sizes.map((count) => take(x, axisOf(dim, x), range(from, (from += count))));
  },
  unsqueeze(x, dim) {
    const shape = [...x.shape];
    shape.splice(dim < 0 ? dim + shape.length + 1 : dim, 0, 1);
    return array(shape, x.data);
  },
  squeeze: (x, dims) => {
    const axes = [dims].flat().map((axis) => axisOf(axis, x));
    return array(x.shape.filter((length, axis) => length > 1 || !axes.includes(axis)), x.data);
  },
  view: reshaped,
  expand: (x, shape) => zip((a) => a)(x, ops.full(shape.map((length) => Math.abs(length)), 0)),
  permute(x, axes) {
    const shape = axes.map((axis) => x.shape[axis]), data = new Array(x.data.length);
    const strides = axes.map((axis) => size(x.shape.slice(axis + 1)));
    for (let index = 0; index < data.length; index++) {
      let rest = index, at = 0;
      for (let axis = axes.length - 1; axis >= 0; axis--) {
        at += (rest % shape[axis]) * strides[axis];
        rest = Math.floor(rest / shape[axis]);
      }
      data[index] = x.data[at];
    }
    return array(shape, data);
  },
  addmm(bias, x, weight) {
    const [rows, inner] = x.shape, columns = weight.shape[1], data = new Float64Array(rows * columns);
    for (let row = 0; row < rows; row++)
      for (let column = 0; column < columns; column++) {
        let sum = bias.data[bias.shape.length > 1 ? row * columns + column : column];
        for (let k = 0; k < inner; k++) sum += x.data[row * inner + k] * weight.data[k * columns + column];
        data[row * columns + column] = sum;
      }
    return array([rows, columns], data);
  },
  linalg_vector_norm(x, order = 2, axes = [], keep = false) {
    if (order !== 2) throw new Error(`linalg_vector_norm: order ${order}`);
    return reduce((list) => Math.hypot(...list))(x, axes, keep);
  },
  sum: reduce((list) => list.reduce((a, b) => a + b, 0)),
  amax: reduce((list) => Math.max(...list)),
  amin: reduce((list) => Math.min(...list)),
  argmin: reduce((list) => list.indexOf(Math.min(...list))),
  min: (x, dim, keep) => [ops.amin(x, dim, keep), ops.argmin(x, dim, keep)],
  sort: (x, dim = -1) => {
    const order = along((list) => range(0, list.length).sort((a, b) => list[a] - list[b]))(x, [dim]);
    return [ops.gather(x, dim, order), order];
  },
  all: reduce((list) => Number(list.every(Boolean))),
  cumsum: along((list) => list.map(((sum) => (value) => (sum += value))(0))),
  take_along_rows: (x, rows) => array(rows.shape, Array.from(rows.data, (row, column) => x.data[row * rows.data.length + column])),
  moved(parts, shape, places) {
    const given = parts.map(lift), data = given.length === 1 ? given[0].data : given.flatMap((part) => Array.from(part.data));
    return array(shape, places.map((place) => data[place]));
  },
  any: reduce((list) => Number(list.some(Boolean))),
};

function decoded({ shape, float32, float64 }) {
  const bytes = Uint8Array.from(atob(float64 ?? float32), (letter) => letter.charCodeAt(0));
  return array(shape, Array.from(float64 === undefined ? new Float32Array(bytes.buffer) : new Float64Array(bytes.buffer)));
}

/** Return the function of a graph: fields {name: {shape, data}} of one row to the elements of its outputs, by name.
 *
 * A field of another shape than the graph was made for is refused: it would broadcast to something else. */
export function compile(graph) {
  const values = Object.fromEntries(Object.entries(graph.constants).map(([name, value]) => [`%${name}`, decoded(value)]));
  const names = Object.entries(graph.inputs), outputs = Object.entries(graph.outputs);
  const isName = (argument) => typeof argument === "string" && argument[0] === "%";
  /** Return a function of nothing to what an argument is now. */
  const bound = (argument) => {
    if (isName(argument)) return () => values[argument];
    if (!Array.isArray(argument) || typeof argument[0] === "number") return () => argument;
    const parts = argument.map(bound);
    return () => parts.map((part) => part());
  };
  const known = (argument) => (Array.isArray(argument) ? argument.every(known) : !isName(argument) || argument in values);
  const steps = [];
  for (const [name, op, given] of graph.nodes) {
    const args = given.map(bound), apply = ops[op], step = () => (values[`%${name}`] = apply(...args.map((argument) => argument())));
    given.every(known) ? step() : steps.push(step);
  }
  return (fields) => {
    for (const [place, name] of names) {
      if (!same(fields[name].shape, graph.shapes[name])) throw new Error(`${name}: shape [${fields[name].shape}] is not [${graph.shapes[name]}]`);
      values[place] = fields[name];
    }
    for (const step of steps) step();
    return Object.fromEntries(outputs.map(([name, place]) => [name, bound(place)().data]));
  };
}
