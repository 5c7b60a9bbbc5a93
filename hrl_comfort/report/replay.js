// Recorded episodes on a canvas. In parallel projection a capsule is exactly a thick line with round ends.
(() => {
  const PIECE = 120, WIDE = 3300, HIGH = 2250, ELEVATION = 0.42, FARTHEST = 30000; // mm, rad
  const TOOL = "rgb(214, 96, 10)", PERSON = "rgb(50, 90, 165)", TAKES = ["#0072B2", "#D55E00"], INK = "#1b1b1b", SOFT = "#5c5c5c";
  const root = document.getElementById("replay");
  const data = JSON.parse(document.getElementById("replay-data").textContent);
  const [canvas, choice, run, line, clock] =
    ["canvas", "select", "button", "input", "output"].map((tag) => root.querySelector(tag));
  const chart = root.querySelector(".series");
  let pen = canvas.getContext("2d");
  let episode, duration, turn = 0, tilt = ELEVATION, time = 0, began = null;

  const decode = (text) => new Int16Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
  const paint = ([red, green, blue, opacity], share = 1) =>
    `rgba(${[red, green, blue].map((value) => Math.min(255, value * share))}, ${opacity})`;

  /** Returns a projection (x, y, z) -> [right, down, away] for a view of `scale` pixels a mm round (middle, centre). */
  function projection(azimuth, middle, centre, scale) {
    const [c, s, sine, cosine] = [Math.cos(azimuth), Math.sin(azimuth), Math.sin(tilt), Math.cos(tilt)];
    return (x, y, z) => {
      const ahead = c * x + s * y;
      return [middle + scale * (s * x - c * y), centre - scale * (sine * ahead + cosine * (z - 100)), cosine * ahead - sine * z];
    };
  }

  function addLine(parts, project, scale, radius, colour, ends) {
    if (ends.some((value) => Math.abs(value) > FARTHEST)) return;
    const [from, to] = [ends.slice(0, 3), ends.slice(3)];
    const pieces = Math.max(1, Math.ceil(Math.hypot(...from.map((value, k) => to[k] - value)) / PIECE));
    const at = (share) => project(...from.map((value, k) => value + share * (to[k] - value)));
    const [first, last] = [at(0), at(1)];
    const length = Math.hypot(last[0] - first[0], last[1] - first[1]);
    const [alongX, alongY] = length < 1 ? [0.01, 0] : [(last[0] - first[0]) / length, (last[1] - first[1]) / length];
    let [across, down] = length < 1 ? [-0.6, -0.8] : [alongY, -alongX];
    if (down > 0 || (down === 0 && across > 0)) [across, down] = [-across, -down]; // the light comes from above
    const [wide, middle] = [scale * radius, [(first[0] + last[0]) / 2, (first[1] + last[1]) / 2]];
    const style = pen.createLinearGradient(
      middle[0] + across * wide, middle[1] + down * wide, middle[0] - across * wide, middle[1] - down * wide);
    style.addColorStop(0, paint(colour, 1.02));
    style.addColorStop(0.3, paint(colour, 1.15));
    style.addColorStop(1, paint(colour, 0.62));
    for (let piece = 0; piece < pieces; piece++) {
      const [start, end] = [at(piece / pieces), at((piece + 1) / pieces)];
      parts.push([(start[2] + end[2]) / 2, () => {
        pen.strokeStyle = style;
        pen.lineWidth = 2 * wide;
        pen.lineCap = piece % (pieces - 1 || 1) ? "butt" : "round"; // round at the ends alone
        pen.beginPath();
        pen.moveTo(start[0], start[1]);
        pen.lineTo(end[0] + alongX, end[1] + alongY); // a pixel over the seam
        pen.stroke();
      }]);
    }
  }

  function addFace(parts, project, [colour, corners]) {
    const seen = corners.map((corner) => project(...corner));
    const area = seen.reduce((sum, [x, y], k) => sum + x * seen[(k + 1) % 4][1] - y * seen[(k + 1) % 4][0], 0);
    if (area > 0) return; // seen from behind: y goes down
    const [[, , low], , [, , high]] = corners;
    parts.push([seen.reduce((sum, point) => sum + point[2] / 4, 0), () => fill(seen, paint(colour, low === high ? 1.1 : 0.75))]);
  }

  function fill(points, style) {
    pen.fillStyle = style;
    pen.beginPath();
    points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.fill();
  }

  /** Draws the places of a point in the pictures up to `last`; `column` is 0 for the tool, 3 for the person. */
  function trail(take, project, last, column, style) {
    const row = take.width - 6 + column;
    const points = [];
    for (let frame = 0; frame <= last; frame++) points.push(take.pictures.slice(frame * take.width + row, frame * take.width + row + 3));
    if (points.some((point) => Math.abs(point[0]) > FARTHEST)) return;
    pen.strokeStyle = style;
    pen.lineWidth = 2 * (window.devicePixelRatio || 1);
    pen.beginPath();
    points.forEach((point, k) => pen[k ? "lineTo" : "moveTo"](...project(...point).slice(0, 2)));
    pen.stroke();
  }

  /** Returns the last picture of a take that is not after the time. */
  const frameAt = ({ times }) => Math.max(0, times.findLastIndex((at) => at <= time));

  /** Returns the next number from `value` on that is 1, 2, 3 … 9 times a power of ten; 1 for 0. */
  function roundUp(value) {
    const unit = 10 ** Math.floor(Math.log10(value || 1));
    return +(Math.ceil((value || 1) / unit - 1e-9) * unit).toPrecision(3);
  }

  function drawTake(take, scene, left, width, height) {
    const scale = Math.min(width / WIDE, height / HIGH);
    const project = projection(episode.azimuth + turn, left + width / 2, height * 0.5, scale);
    const { times, pictures } = take, frame = frameAt(take);
    const next = Math.min(frame + 1, times.length - 1);
    const share = next === frame ? 0 : Math.min(1, (time - times[frame]) / (times[next] - times[frame]));
    pen.save();
    pen.beginPath();
    pen.rect(left, 0, width, height);
    pen.clip();
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]];
    fill(corners.map(([x, y]) => project(1700 * x, 1700 * y, scene.floor)), "#dfe2df");
    trail(take, project, frame, 3, PERSON);
    const parts = [];
    scene.faces.forEach((face) => addFace(parts, project, face));
    scene.still.forEach(([radius, colour, ...ends]) => addLine(parts, project, scale, radius, colour, ends));
    scene.moving.forEach(([radius, colour], k) => {
      const at = (picture) => Array.from(pictures.slice(picture * take.width + 6 * k, picture * take.width + 6 * k + 6));
      const [now, then] = [at(frame), at(next)];
      const jumps = now.some((value, k) => Math.abs(value - then[k]) > 1000); // an object that appears
      addLine(parts, project, scale, radius, colour, now.map((value, k) => value + (jumps ? 0 : share) * (then[k] - value)));
    });
    parts.sort((one, other) => other[0] - one[0]).forEach(([, draw]) => draw());
    trail(take, project, frame, 0, TOOL);
    pen.fillStyle = INK;
    pen.font = `${13 * (window.devicePixelRatio || 1)}px sans-serif`;
    pen.fillText(take.title, left + 0.02 * width, 0.06 * height);
    pen.restore();
  }

  /** Sizes a canvas to its place on the page and clears it; returns width, height and pixels a CSS pixel. */
  function clear(on) {
    const ratio = window.devicePixelRatio || 1;
    const width = Math.round(on.clientWidth * ratio), height = Math.round(on.clientHeight * ratio);
    if (on.width !== width || on.height !== height) [on.width, on.height] = [width, height];
    pen = on.getContext("2d");
    pen.clearRect(0, 0, width, height);
    return [width, height, ratio];
  }

  function stroke(from, to, style) {
    pen.strokeStyle = style;
    pen.beginPath();
    pen.moveTo(...from);
    pen.lineTo(...to);
    pen.stroke();
  }

  /** Draws each quantity over time in a row of its own, a colour a take, and a mark at the time of the picture. */
  function drawSeries() {
    const [width, height, ratio] = clear(chart);
    const names = Object.keys(episode.takes[0].series);
    const [left, right, foot] = [34 * ratio, width - 8 * ratio, 34 * ratio];
    const high = (height - foot) / names.length;
    const x = (at) => left + ((right - left) * at) / (duration || 1);
    const write = (text, at, down, style, align) => {
      [pen.fillStyle, pen.textAlign, pen.font] = [style, align, `${12 * ratio}px sans-serif`];
      pen.fillText(text, at, down);
    };
    names.forEach((name, row) => {
      const [top, bottom] = [row * high + 18 * ratio, (row + 1) * high - 4 * ratio];
      const most = roundUp(Math.max(...episode.takes.flatMap((take) => take.series[name])));
      const y = (value) => bottom - ((bottom - top) * value) / most;
      pen.lineWidth = ratio;
      for (const value of [0, most]) {
        stroke([left, y(value)], [right, y(value)], "#dddddd");
        write(`${value}`, left - 4 * ratio, y(value) + 4 * ratio, SOFT, "right");
      }
      write(name, left + 4 * ratio, top - 6 * ratio, INK, "left");
      episode.takes.forEach((take, k) => {
        const values = take.series[name];
        [pen.strokeStyle, pen.lineWidth] = [TAKES[k], 1.6 * ratio];
        pen.setLineDash(k ? [5 * ratio, 3 * ratio] : []);
        pen.beginPath();
        values.forEach((value, frame) => pen[frame ? "lineTo" : "moveTo"](x(take.times[frame]), y(value)));
        pen.stroke();
        pen.setLineDash([]);
        write(`${+values[frameAt(take)].toPrecision(3)}`, right - (episode.takes.length - 1 - k) * 60 * ratio, top - 6 * ratio, TAKES[k], "right");
      });
    });
    const step = roundUp(duration / 6);
    for (let at = 0; at <= duration; at += step) write(`${+at.toFixed(2)} s`, x(at), height - foot + 14 * ratio, SOFT, "center");
    if (episode.takes.length > 1) episode.takes.forEach(({ title }, k) =>
      write(`${k ? "- -" : "—"} ${title}`, left + k * 0.45 * width, height - 4 * ratio, TAKES[k], "left"));
    pen.lineWidth = ratio;
    stroke([x(time), 4 * ratio], [x(time), height - foot], INK);
  }

  function draw() {
    const [width, height] = clear(canvas);
    const each = width / episode.takes.length;
    episode.takes.forEach((take, k) => drawTake(take, data.scenes[episode.scene], k * each, each, height));
    drawSeries();
    line.value = time;
    clock.value = `${time.toFixed(1)} s of ${duration.toFixed(1)} s`;
  }

  function play(now) {
    if (began === null) return;
    time = (now - began) / 1000;
    if (time >= duration) stop(duration);
    else requestAnimationFrame(play);
    draw();
  }

  function stop(at) {
    [time, began, run.textContent] = [at, null, "Play"];
  }

  run.onclick = () => {
    if (began !== null) return stop(time);
    began = performance.now() - 1000 * (time >= duration ? 0 : time);
    run.textContent = "Pause";
    requestAnimationFrame(play);
  };
  line.oninput = () => {
    stop(Number(line.value));
    draw();
  };
  canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
  canvas.onpointermove = (event) => {
    if (!event.buttons) return;
    turn -= event.movementX / 150;
    tilt = Math.min(1.5, Math.max(0.05, tilt + event.movementY / 200));
    draw();
  };
  chart.onpointerdown = chart.onpointermove = (event) => {
    if (!event.buttons) return;
    const at = (event.offsetX - 34) / (chart.clientWidth - 42);
    stop(duration * Math.min(1, Math.max(0, at)));
    draw();
  };
  choice.onchange = () => {
    episode = data.episodes[choice.selectedIndex];
    const { moving } = data.scenes[episode.scene];
    for (const take of episode.takes) {
      take.pictures ??= decode(take.frames);
      take.width = 6 * (moving.length + 1);
    }
    duration = Math.max(...episode.takes.map((take) => take.times.at(-1)));
    line.max = duration;
    stop(0);
    draw();
  };
  data.episodes.forEach(({ title }) => choice.append(new Option(title)));
  choice.onchange();
  new ResizeObserver(draw).observe(canvas);
})();
