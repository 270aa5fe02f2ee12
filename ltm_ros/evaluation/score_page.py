"""The page of `ltm_ros.evaluation.score_report`: the style of the run's report, its own body."""

from ltm_ros.evaluation.run_page import PAGE as RUN_PAGE

STYLE = RUN_PAGE.partition("<style>")[2].partition("</style>")[0]

PAGE = (
    """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>"""
    + STYLE
    + """
figure.sheet { margin: 1.2rem 0 2rem; }
figcaption a { color: var(--accent); }
.two { display: grid; grid-template-columns: 1fr 1fr; gap: 1.2rem; align-items: end; }
@media (max-width: 52rem) { .two { grid-template-columns: 1fr; } }
h3 { margin-bottom: 0.6rem; }
</style>
</head>
<body>
<header>
<h1>{{ title }}</h1>
<p class="lead">{{ score.frames }} frames with truth. Depth, labels and fuel cells of the recorded run against what the
simulation knows; the figures are the paper's, with this run's data.</p>
</header>
{% for name, figures in sections.items() %}
<h2>{{ name }}</h2>
<div{% if name == "Terrain" %} class="two"{% endif %}>
{% for figure in figures %}
<figure class="sheet"><label class="zoom"><input type="checkbox" aria-label="Enlarge: {{ figure.caption }}">
<img alt="{{ figure.caption }}" src="{{ figure.picture | picture }}"></label>
<figcaption>{{ figure.caption }} <a href="{{ figure.file }}">{{ figure.file }}</a></figcaption>
</figure>
{% endfor %}
</div>
{% endfor %}
<h2>Scores</h2>
{% for table in tables %}
<h3>{{ table.title | capitalize }}</h3>
<div class="scroll"><table>
<tr>{% for column in table.columns %}<th{% if loop.index0 > 1 %} class="n"{% endif %}>{{ column }}</th>{% endfor %}</tr>
{% for row in table.rows %}
<tr>{% for value in row %}<td{% if loop.index0 > 1 %} class="n"{% endif %}>{{ value | shown }}</td>{% endfor %}</tr>
{% endfor %}
</table></div>
{% if table.note %}<p class="note">{{ table.note }}</p>{% endif %}
{% endfor %}
{% if lacking %}
<h2>What is lacking</h2>
<ul>
{% for reason in lacking %}
<li>{{ reason }}</li>
{% endfor %}
</ul>
{% endif %}
<h2>What ran</h2>
<dl>
<dt>recording</dt><dd><code>{{ bag }}</code></dd>
<dt>network</dt><dd>{{ model }}</dd>
</dl>
</body>
</html>
"""
)
