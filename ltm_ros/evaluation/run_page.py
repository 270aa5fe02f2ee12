"""The page of `ltm_ros.evaluation.run_report`: HTML and style in one Jinja template, without any outside resource."""

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ data.title }}</title>
<style>
:root {
  color-scheme: light dark;
  --paper: #fbfbf9; --card: #ffffff; --ink: #1d2126; --soft: #626b75; --line: #e3e4e0;
  --accent: #b4491f; --good: 38 122 77; --bad: 190 60 45; --bar: #c9764f;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14171a; --card: #1b1f23; --ink: #e8e8e4; --soft: #9aa3ac; --line: #2d3238;
    --accent: #f0936a; --good: 84 180 125; --bad: 230 110 95; --bar: #b5643d;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0 auto; padding: 3.5rem 1.5rem 5rem; max-width: 72rem; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", "Inter", "Helvetica Neue", Arial, sans-serif;
}
h1 { font-size: 2.1rem; line-height: 1.15; letter-spacing: -0.02em; margin: 0 0 0.5rem; font-weight: 680; }
h2 { font-size: 1.2rem; letter-spacing: -0.01em; margin: 3.2rem 0 0.9rem; font-weight: 640; }
p { margin: 0.4rem 0; max-width: 46rem; }
.lead { font-size: 1.08rem; color: var(--soft); }
.note { color: var(--soft); font-size: 0.9rem; }
code { font: 0.88em/1.5 ui-monospace, "SF Mono", Menlo, Consolas, "DejaVu Sans Mono", monospace; }
pre { background: var(--card); border: 1px solid var(--line); border-radius: 8px;
  padding: 0.8rem 1rem; overflow-x: auto; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(11rem, 1fr)); gap: 0.9rem; margin: 2rem 0 0; }
.tile { background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 0.9rem 1.1rem; }
.tile b { display: block; font-size: 1.65rem; line-height: 1.25; font-weight: 660; letter-spacing: -0.02em;
  font-variant-numeric: tabular-nums; }
.tile span, dt { color: var(--soft); font-size: 0.85rem; }
.tile small { color: var(--soft); overflow-wrap: anywhere; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 0.3rem 1.6rem; margin: 0; }
dt { padding-top: 0.1rem; }
dd { margin: 0; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.93rem; min-width: 34rem; }
table.wide { width: 100%; }
th { text-align: left; font-weight: 560; color: var(--soft); font-size: 0.83rem; padding: 0.35rem 1rem 0.35rem 0;
  border-bottom: 1px solid var(--line); vertical-align: bottom; }
td { padding: 0.38rem 1rem 0.38rem 0; border-bottom: 1px solid var(--line); }
th.n, td.n { text-align: right; }
tr.sum td { font-weight: 620; border-bottom: 0; }
.bar { display: inline-block; height: 0.55rem; border-radius: 3px; background: var(--bar); vertical-align: middle; }
.confusion td.n, .confusion th.n { padding: 0.38rem 0.7rem; }
.row { display: grid; grid-template-columns: repeat(3, 1fr); gap: 0.8rem; margin: 0.9rem 0 1.8rem; }
@media (max-width: 52rem) { .row { grid-template-columns: 1fr; } dl { grid-template-columns: 1fr; gap: 0; } }
figure { margin: 0; }
figcaption { color: var(--soft); font-size: 0.85rem; margin-top: 0.35rem; }
.map { max-width: 46rem; }
.legend { display: flex; flex-wrap: wrap; gap: 0.4rem 1.2rem; align-items: center; font-size: 0.88rem; }
.legend .scale { width: 34rem; max-width: 100%; margin-right: 1rem; }
.legend i { display: inline-block; width: 0.85rem; height: 0.85rem; border-radius: 3px; margin-right: 0.4rem;
  vertical-align: -0.08rem; border: 1px solid rgb(0 0 0 / 0.25); }
h3 { font-size: 1rem; font-weight: 600; margin: 1.6rem 0 0; }
img { display: block; width: 100%; height: auto; border-radius: 8px; border: 1px solid var(--line); }
.zoom { display: block; cursor: zoom-in; }
.zoom input { position: absolute; opacity: 0; pointer-events: none; }
.zoom input:focus-visible + img { outline: 2px solid var(--accent); outline-offset: 2px; }
.zoom input:checked + img {
  position: fixed; inset: 0; width: 100vw; height: 100vh; object-fit: contain; z-index: 9; cursor: zoom-out;
  background: rgb(10 12 14 / 0.92); border: 0; border-radius: 0; padding: 1.5rem;
}
</style>
</head>
<body>
{% macro zoomable(image, text) %}
<label class="zoom"><input type="checkbox" aria-label="Enlarge: {{ text }}">
<img alt="{{ text }}" src="{{ image | picture }}"></label>
{% endmacro %}
{% macro matrix(confusion, what) %}
<div class="scroll"><table class="confusion">
<tr><th>truth ↓ &nbsp; {{ what }} →</th>
{% for head in confusion.heads %}<th class="n">{{ head }}</th>{% endfor %}
<th class="n">right</th></tr>
{% for name, cells, right in confusion.rows %}
<tr><td>{{ name }}</td>
{% for value, share, hit in cells %}
{% set strength = '%.2f' | format(0.06 + 0.5 * share) %}
{% set paint = 'good' if hit else 'bad' %}
<td class="n"{% if value %} style="background: rgb(var(--{{ paint }}) / {{ strength }})"{% endif %}>
{{ value | count }}</td>
{% endfor %}
<td class="n">{{ right | percent }}</td></tr>
{% endfor %}
</table></div>
{% endmacro %}
<header>
<h1>{{ data.title }}</h1>
<p class="lead">{{ data.summary }}</p>
</header>
{% if tiles %}
<section class="tiles">
{% for name, value, remark in tiles %}
<div class="tile"><span>{{ name }}</span><b>{{ value }}</b><small>{{ remark }}</small></div>
{% endfor %}
</section>
{% endif %}
{% if data.fuel_map is not none %}
<h2>Fuel map</h2>
<figure class="map">{{ zoomable(data.fuel_map, "Fuel map over shaded relief, with the cameras' sectors") }}
<figcaption>Life form of each cell, from the prior map and what cameras have seen; outlined: what each looks at.
</figcaption>
</figure>
{% endif %}
{% for sheet in data.sheets %}
<h2>{{ sheet.title }}</h2>
<figure>{{ zoomable(sheet.picture, sheet.title) }}
<figcaption>{{ sheet.caption }}</figcaption>
</figure>
{% endfor %}
{% if data.cameras %}
<h2>What the cameras saw</h2>
<div class="legend">
<img class="scale" alt="Colours of depth, from near to far" src="{{ range_legend | picture }}">
{% for name, color in classes %}
<span><i style="background: rgb{{ color }}"></i>{{ name }}</span>
{% endfor %}
</div>
{% for camera in data.cameras %}
<h3>{{ camera.camera }}</h3>
{% if camera.caption %}<p class="note">{{ camera.caption }}</p>{% endif %}
<div class="row">
<figure>{{ zoomable(camera.photo, camera.camera ~ ": photo") }}
<figcaption>Photo</figcaption>
</figure>
<figure>{{ zoomable(camera.depth, camera.camera ~ ": traced depth") }}
<figcaption>Traced depth; dark lines at 1, 2 and 5 times each power of ten</figcaption>
</figure>
<figure>{{ zoomable(camera.labels, camera.camera ~ ": labels") }}
<figcaption>Labels</figcaption>
</figure>
</div>
{% endfor %}
{% endif %}
{% if data.nodes %}
<h2>Nodes</h2>
<div class="scroll"><table class="wide">
<tr><th>node</th>
<th class="n">frames in</th>
<th class="n">out</th>
<th class="n">dropped</th>
<th class="n">latency p50, ms</th>
<th class="n">latency p95, ms</th>
<th class="n">work p50, ms</th></tr>
{% for node in data.nodes %}
<tr><td><code>{{ node.node }}</code></td>
<td class="n">{{ node.received | count }}</td>
<td class="n">{{ node.published | count }}</td>
<td class="n">{{ node.dropped | count }}
{% if node.causes %}<span class="note">({{ node.causes }})</span>{% endif %}</td>
<td class="n">{{ node.latency_p50_ms | number(1) }}</td>
<td class="n">{{ node.latency_p95_ms | number(1) }}</td>
<td class="n">{{ node.work_p50_ms | number(1) }}</td></tr>
{% endfor %}
</table></div>
<p class="note">Latency: from the moment a frame was taken to the moment the node published its result.
Work: the node's own time.</p>
{% endif %}
{% if data.depth %}
<h2>Depth against truth</h2>
<div class="scroll"><table>
<tr><th>true depth</th>
<th class="n">pixels</th>
<th class="n">median error, m</th>
<th></th>
<th class="n">mean, m</th>
<th class="n">RMSE, m</th>
<th class="n">bias, m</th></tr>
{% for name, score in bins %}
<tr{% if name == "all" %} class="sum"{% endif %}><td>{{ name }}</td>
<td class="n">{{ score.pixels | count }}</td>
<td class="n">{{ score.median | number }}</td>
<td>{% if score.pixels %}<span class="bar" style="width: {{ '%.1f' | format(8 * score.median / worst) }}rem"></span>
{% endif %}</td>
<td class="n">{{ score.mae | number }}</td>
<td class="n">{{ score.rmse | number }}</td>
<td class="n">{{ score.bias | number }}</td></tr>
{% endfor %}
</table></div>
{% endif %}
{% if labels is not none %}
<h2>Labels against truth</h2>
<p class="note">Pixels by true class (rows) and label (columns).</p>
{{ matrix(labels, "label") }}
{% endif %}
{% if fuel is not none %}
<h2>Fuel cells against truth</h2>
<p class="note">{{ data.fuel.seen | count }} of {{ data.fuel.cells | count }} cells were seen,
{{ data.fuel.right | count }} of these are right. Rows: true class; columns: class in the map.</p>
{{ matrix(fuel, "map") }}
{% endif %}
{% for table in data.tables %}
<h2>{{ table.title }}</h2>
<div class="scroll"><table>
<tr>{% for column in table.columns %}
<th{% if table.rows and table.rows[0][loop.index0] is numeric %} class="n"{% endif %}>{{ column }}</th>
{% endfor %}</tr>
{% for row in table.rows %}
<tr>{% for value in row %}<td{% if value is numeric %} class="n"{% endif %}>{{ value | number }}</td>{% endfor %}</tr>
{% endfor %}
</table></div>
{% if table.note %}<p class="note">{{ table.note }}</p>{% endif %}
{% endfor %}
<h2>What ran</h2>
<dl>
{% for name, value in data.conditions %}
<dt>{{ name }}</dt><dd>{{ value }}</dd>
{% endfor %}
</dl>
{% if data.files %}
<h2>Files</h2>
<dl>
{% for name, what in data.files %}
<dt><code>{{ name }}</code></dt><dd>{{ what }}</dd>
{% endfor %}
</dl>
{% endif %}
{% if data.recording %}
<h2>See it move</h2>
<p>The whole run in 3D: terrain, camera frustums, depth points and the fuel layer as it grows.</p>
<pre><code>ltm view --rrd {{ data.recording }}</code></pre>
{% endif %}
</body>
</html>
"""
