// Draws the charts of a report from the data block beside it. Runs offline: no request leaves the page.
(function () {
  "use strict";
  var block = document.getElementById("chart-data");
  if (!block) return;
  var specs = JSON.parse(block.textContent);
  var plots = Array.prototype.slice.call(document.querySelectorAll("[data-chart]"));
  var root = document.documentElement;
  var groups = {};

  function colour(name) { return getComputedStyle(root).getPropertyValue("--" + name).trim(); }
  function faded(name, share) {
    var c = colour(name), m = /^#(..)(..)(..)$/.exec(c);
    return m ? "rgba(" + [m[1], m[2], m[3]].map(function (h) { return parseInt(h, 16); }).join(",") + "," + share + ")" : c;
  }

  // Little-endian float32 in base64. NaN: a gap. Infinity: nothing at this x, the line goes on.
  function unpack(text, origin) {
    var raw = atob(text), view = new DataView(new ArrayBuffer(raw.length)), out = [], i, v;
    for (i = 0; i < raw.length; i++) view.setUint8(i, raw.charCodeAt(i));
    for (i = 0; i + 3 < raw.length; i += 4) {
      v = view.getFloat32(i, true);
      out.push(v !== v ? null : v === Infinity ? undefined : v + origin);
    }
    return out;
  }

  function figure(v) {
    if (v == null) return "–";
    var a = Math.abs(v);
    var s = v === 0 ? "0" : a >= 1e6 || a < 1e-4 ? v.toExponential(2) : a >= 1e3 ? v.toFixed(1) : String(Number(v.toPrecision(4)));
    return s.replace("-", "−");
  }
  function ticks(u, splits, axis, space, incr) {
    var s = String(incr), e = s.indexOf("e-"), d = s.indexOf(".");
    var decimals = e >= 0 ? Number(s.slice(e + 2)) : d >= 0 ? s.length - d - 1 : 0;
    return splits.map(function (v) {
      if (v == null) return "";
      var t = decimals > 5 || Math.abs(v) >= 1e6 ? v.toExponential(1) : v.toFixed(decimals);
      return (Number(t) === 0 ? t.replace("-", "") : t).replace("-", "−");
    });
  }
  function titled(axis) { return axis.unit ? axis.label + " [" + axis.unit + "]" : axis.label; }
  function withUnit(axis) {
    return function (u, v) { return v == null ? "–" : figure(v) + (axis.unit ? " " + axis.unit : ""); };
  }

  function seriesOf(spec) {
    var list = [{ label: spec.x.label, value: withUnit(spec.x) }];
    spec.series.forEach(function (s) {
      var o = { label: s.name, show: s.shown, value: withUnit(spec.y) };
      var stroke = function () { return s.role === "measured" ? faded(s.role, 0.75) : colour(s.role); };
      if (s.style === "line") {
        o.stroke = stroke;
        o.width = s.role === "measured" ? 2.6 : 1.3;
        if (s.role === "blackbox") o.dash = [6, 4];
        o.points = { show: false };
      } else if (s.style === "points") {
        o.paths = function () { return null; };
        o.points = { show: true, size: 3, width: 0, fill: function () { return faded(s.role, 0.28); }, stroke: function () { return faded(s.role, 0.28); } };
        o.class = "edge";
      } else {
        o.stroke = "transparent";
        o.points = { show: false };
        o.class = "edge";
      }
      list.push(o);
    });
    return list;
  }

  // Edges come in pairs, upper then lower, right after the line they belong to.
  function bandsOf(spec) {
    var bands = [];
    spec.series.forEach(function (s, i) {
      if (s.style === "edge" && i > 0 && spec.series[i - 1].style === "edge" && spec.series[i - 2] && spec.series[i - 2].style === "line")
        bands.push({ series: [i, i + 1], fill: function () { return faded(s.role, 0.2); } });
    });
    return bands;
  }

  function shade(spec) {
    return function (u) {
      var c = u.ctx, b = u.bbox, px = window.devicePixelRatio || 1;
      c.save();
      spec.regions.forEach(function (r, k) {
        var min = u.scales.x.min, max = u.scales.x.max;
        if (r.high < min || r.low > max) return;
        var a = u.valToPos(Math.max(r.low, min), "x", true), z = u.valToPos(Math.min(r.high, max), "x", true);
        c.fillStyle = colour("region");
        c.fillRect(a, b.top, Math.max(z - a, px), b.height);
        c.fillStyle = colour("regionline");
        if (r.low >= min) c.fillRect(a, b.top, px, b.height);
        if (r.high <= max) c.fillRect(z - px, b.top, px, b.height);
        var label = r.label;
        c.font = 11 * px + "px system-ui, sans-serif";
        if (label && c.measureText(label).width < z - a - 8 * px) {
          c.fillStyle = colour("soft");
          c.textAlign = "left"; c.textBaseline = "top";
          c.fillText(label, a + 5 * px, b.top + 4 * px);
        }
      });
      c.restore();
    };
  }
  function zero(u) {
    var s = u.scales.y;
    if (!(s.min < 0 && s.max > 0)) return;
    var px = window.devicePixelRatio || 1;
    u.ctx.fillStyle = colour("zero");
    u.ctx.fillRect(u.bbox.left, Math.round(u.valToPos(0, "y", true)), u.bbox.width, px);
  }

  function axis(text, size) {
    var font = "12px system-ui, sans-serif";
    return {
      label: text, labelSize: 18, labelFont: font, font: font, labelGap: 2, size: size, gap: 4, values: ticks,
      stroke: function () { return colour("soft"); },
      grid: { stroke: function () { return colour("grid"); }, width: 1 },
      ticks: { stroke: function () { return colour("grid"); }, width: 1, size: 5 }
    };
  }

  function full(u) { var x = u.data[0]; return [x[0], x[x.length - 1]]; }
  function zoomed(u) {
    var f = full(u), s = u.scales.x, e = (f[1] - f[0]) * 1e-6;
    return s.min > f[0] + e || s.max < f[1] - e;
  }
  function setX(u, min, max) {
    var f = full(u);
    u.setScale("x", { min: Math.max(min, f[0]), max: Math.min(max, f[1]) });
  }
  function reset(u) { u.setData(u.data, true); }

  function follow(spec, plot) {
    return function (u, key) {
      if (key !== "x" || u.scales.x.min == null) return;
      var s = u.scales.x;
      if (plot.button) plot.button.hidden = !zoomed(u);
      if (!spec.sync) return;
      var g = groups[spec.sync];
      g.range = zoomed(u) ? [s.min, s.max] : null;
      g.charts.forEach(function (other) {
        var o = other.scales.x;
        if (other !== u && (o.min !== s.min || o.max !== s.max)) other.setScale("x", { min: s.min, max: s.max });
      });
    };
  }

  function keys(u) {
    return function (event) {
      if (event.target !== event.currentTarget || event.ctrlKey || event.metaKey || event.altKey) return;
      var s = u.scales.x, w = s.max - s.min, m = 0.5 * (s.max + s.min), f = full(u), d;
      if (event.key === "+" || event.key === "=") setX(u, m - 0.35 * w, m + 0.35 * w);
      else if (event.key === "-") setX(u, m - 0.72 * w, m + 0.72 * w);
      else if (event.key === "ArrowLeft") { d = Math.min(0.2 * w, s.min - f[0]); setX(u, s.min - d, s.max - d); }
      else if (event.key === "ArrowRight") { d = Math.min(0.2 * w, f[1] - s.max); setX(u, s.min + d, s.max + d); }
      else if (event.key === "0" || event.key === "Escape") reset(u);
      else return;
      event.preventDefault();
    };
  }

  // The legend switches curves; make that reachable without a mouse.
  function legend(u, spec) {
    var rows = u.root.querySelectorAll(".u-legend .u-series");
    spec.series.forEach(function (s, i) {
      var th = rows[i + 1] && rows[i + 1].querySelector("th");
      if (!th || s.style !== "line") return;
      th.tabIndex = 0;
      th.setAttribute("role", "button");
      th.setAttribute("aria-pressed", String(s.shown));
      th.addEventListener("keydown", function (event) {
        if (event.key === "Enter" || event.key === " ") { event.preventDefault(); th.click(); }
      });
    });
    return rows;
  }

  function width(plot) { return root.classList.contains("printing") ? Math.min(plot.clientWidth || 660, 660) : plot.clientWidth; }

  function build(plot) {
    if (plot.chart || width(plot) < 40) return;
    var spec = specs[Number(plot.getAttribute("data-chart"))];
    if (!spec) return;
    plot.textContent = "";
    var rows, button = plot.parentNode.querySelector("button");
    plot.button = button;
    var data = [unpack(spec.xs, spec.origin)].concat(spec.series.map(function (s) { return unpack(s.values, 0); }));
    if (spec.sync && !groups[spec.sync]) groups[spec.sync] = { charts: [], range: null };
    var u = new uPlot({
      width: width(plot), height: spec.height, series: seriesOf(spec), bands: bandsOf(spec),
      scales: { x: { time: false } },
      axes: [axis(titled(spec.x), 26), axis(titled(spec.y), 56)],
      padding: [8, 10, 0, 0],
      legend: { live: true, markers: { fill: function (c, i) { return i ? colour(spec.series[i - 1].role) : "transparent"; }, width: 0 } },
      cursor: { drag: { x: true, y: true, uni: 40, dist: 4 }, sync: spec.sync ? { key: spec.sync, scales: ["x", null] } : undefined, points: { size: 6 } },
      hooks: {
        drawClear: [shade(spec)], drawAxes: [zero], setScale: [follow(spec, plot)],
        setSeries: [function (c, i, o) {
          if (i == null || !o || o.show == null) return;
          if (rows && rows[i]) { var th = rows[i].querySelector("th"); if (th.tabIndex === 0) th.setAttribute("aria-pressed", String(c.series[i].show)); }
          // A line takes its band and its dots with it.
          if (spec.series[i - 1].style !== "line") return;
          spec.series.forEach(function (s, k) {
            if (s.style !== "line" && s.role === spec.series[i - 1].role && c.series[k + 1].show !== o.show) c.setSeries(k + 1, { show: o.show });
          });
        }]
      }
    }, data, plot);
    plot.chart = u;
    rows = legend(u, spec);
    if (!plot.wired) {
      plot.wired = true;
      plot.addEventListener("keydown", function (event) { if (plot.chart) keys(plot.chart)(event); });
      if (button) button.addEventListener("click", function () { if (plot.chart) reset(plot.chart); plot.focus(); });
    }
    if (spec.sync) {
      var g = groups[spec.sync];
      g.charts.push(u);
      if (g.range) u.setScale("x", { min: g.range[0], max: g.range[1] });
    }
    root.setAttribute("data-charts-drawn", String(plots.filter(function (p) { return p.chart; }).length));
  }
  function discard(plot) {
    var u = plot.chart;
    if (!u) return;
    Object.keys(groups).forEach(function (k) { groups[k].charts = groups[k].charts.filter(function (c) { return c !== u; }); });
    u.destroy();
    plot.chart = null;
  }
  function rebuild() {
    var drawn = plots.filter(function (p) { return p.chart; });
    drawn.forEach(discard);
    drawn.forEach(build);
  }

  // Charts are drawn when they come near the screen, so that a long report opens at once.
  if (window.IntersectionObserver) {
    var near = new IntersectionObserver(function (entries) {
      entries.forEach(function (e) { if (e.isIntersecting) build(e.target); });
    }, { rootMargin: "600px" });
    plots.forEach(function (p) { near.observe(p); });
  } else plots.forEach(build);
  if (window.ResizeObserver) {
    var size = new ResizeObserver(function (entries) {
      entries.forEach(function (e) {
        var u = e.target.chart, w = width(e.target);
        if (u && w >= 40 && Math.abs(w - u.width) > 1) u.setSize({ width: w, height: u.height });
      });
    });
    plots.forEach(function (p) { size.observe(p); });
  }
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", rebuild);

  var closed = [];
  window.addEventListener("beforeprint", function () {
    root.classList.add("printing");
    closed = Array.prototype.slice.call(document.querySelectorAll("details:not([open])"));
    closed.forEach(function (d) { d.open = true; });
    plots.forEach(discard);
    plots.forEach(build);
  });
  window.addEventListener("afterprint", function () {
    root.classList.remove("printing");
    closed.forEach(function (d) { d.open = false; });
    rebuild();
  });
})();
