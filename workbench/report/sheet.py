"""The style of the page, and the script that enlarges pictures; the page works without scripts."""

from workbench.report.palette import COLOURS

_LIGHT = "".join(f"--{colour.name}:{colour.light};" for colour in COLOURS)
_DARK = "".join(f"--{colour.name}:{colour.dark};" for colour in COLOURS)

#: The colours by name, those of a dark screen too.
VARIABLES = f"""
:root{{color-scheme:light dark;{_LIGHT}}}
@media screen and (prefers-color-scheme:dark){{:root{{{_DARK}}}}}"""

STYLE = f"""{VARIABLES}
*{{box-sizing:border-box}}
html{{scroll-behavior:smooth;scroll-padding-top:1rem;-webkit-text-size-adjust:100%}}
body{{margin:0 auto;max-width:78rem;padding:0 1.5rem 4rem;background:var(--paper);color:var(--ink);
 font:1rem/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue","Noto Sans",Arial,sans-serif;
 display:grid;grid-template-columns:14rem minmax(0,54rem);column-gap:3.5rem}}
main{{grid-column:2}}
h1,h2,h3{{line-height:1.2;font-weight:650;overflow-wrap:anywhere;text-wrap:balance}}
h1{{font-size:2rem;letter-spacing:-.015em;margin:2.75rem 0 1.1rem}}
h2{{font-size:1.35rem;margin:3.25rem 0 1rem;padding-top:.9rem;border-top:1px solid var(--grid)}}
h3{{font-size:1rem;margin:0 0 .6rem}}
p{{max-width:42rem;margin:.75rem 0;overflow-wrap:anywhere}}
a{{color:var(--accent);text-underline-offset:.18em;text-decoration-thickness:.06em}}
a:focus-visible,button:focus-visible,summary:focus-visible,
[tabindex]:focus-visible{{outline:2px solid var(--accent);outline-offset:3px;border-radius:2px}}
.skip{{position:absolute;left:-99rem}}
.skip:focus{{left:1rem;top:1rem;background:var(--paper);padding:.5rem;z-index:2}}
.verdict{{font-size:1.2rem;line-height:1.5;max-width:none;margin:0;padding:1.1rem 1.4rem;background:var(--card);
 border-left:4px solid var(--accent);border-radius:0 6px 6px 0}}
.verdict p{{max-width:none;margin:.6rem 0}}
.verdict p:first-child{{margin-top:0}}
.verdict p:last-child{{margin-bottom:0}}
.asked{{color:var(--muted);margin:0 0 .4rem}}
.todo{{font-size:1.2rem;line-height:1.4;font-weight:600}}
.todo p{{max-width:none;margin:.3rem 0}}
.badges{{list-style:none;display:grid;grid-template-columns:repeat(auto-fit,minmax(13rem,1fr));gap:.8rem;
 margin:1.1rem 0;padding:0}}
.badges li{{background:var(--card);border-left:4px solid var(--muted);border-radius:0 6px 6px 0;padding:.6rem .9rem}}
.badges .good{{border-color:var(--series-3)}}
.badges .open{{border-color:var(--series-5)}}
.badges .bad{{border-color:var(--series-2)}}
.badges span{{color:var(--muted);font-size:.8rem;font-weight:600;display:block}}
.badges strong::before{{margin-right:.4em}}
.badges .good strong::before{{content:"\\2713";color:var(--series-3)}}
.badges .open strong::before{{content:"?";color:var(--series-5)}}
.badges .bad strong::before{{content:"\\2717";color:var(--series-2)}}
.badges p{{margin:.15rem 0 0;font-size:.9rem;line-height:1.4}}
details{{margin:1rem 0}}
summary{{color:var(--accent);font-weight:600;cursor:pointer;padding:.4rem 0}}
summary:hover{{text-decoration:underline}}
nav{{grid-column:1;position:sticky;top:0;align-self:start;max-height:100vh;overflow-y:auto;padding:3.1rem .25rem 2rem 0;
 font-size:.85rem;line-height:1.35}}
nav p{{margin:0 0 .6rem;color:var(--muted);font-weight:600}}
nav ol{{list-style:none;margin:0;padding:0}}
nav li{{margin:.45rem 0;overflow-wrap:anywhere}}
nav li ol{{padding-left:.8rem;border-left:1px solid var(--grid)}}
nav li li a{{color:var(--muted)}}
nav a{{text-decoration:none}}
nav a:hover{{text-decoration:underline}}
figure,.table{{margin:1.75rem 0 2.5rem}}
.picture{{overflow-x:auto}}
.picture svg{{display:block;width:100%;min-width:29rem;height:auto;overflow:hidden}}
svg *{{stroke-linejoin:round;stroke-linecap:butt}}
svg text{{font-family:inherit;font-variant-numeric:tabular-nums}}
figcaption,.caption{{color:var(--muted);font-size:.88rem;line-height:1.45;max-width:42rem;margin:.6rem 0 0}}
.tools{{white-space:nowrap;font-weight:600}}
.tools a{{text-decoration:none}}
.tools a:hover,button:hover{{text-decoration:underline}}
.scroll{{overflow-x:auto}}
table{{border-collapse:collapse;font-size:.92rem;font-variant-numeric:tabular-nums lining-nums}}
th,td{{text-align:left;padding:.36rem 1.4rem .36rem 0;vertical-align:baseline;border-bottom:1px solid var(--grid)}}
thead th{{color:var(--muted);font-weight:600;vertical-align:bottom;border-bottom:1.5px solid var(--muted)}}
tbody th{{font-weight:400}}
th.n,td.n{{text-align:right;padding-left:.9rem;padding-right:.6rem;white-space:nowrap}}
thead th.n{{white-space:normal}}
td strong{{font-weight:700;color:var(--accent)}}
.provenance td{{overflow-wrap:anywhere;font-size:.82rem;
 font-family:ui-monospace,"SF Mono",Consolas,"DejaVu Sans Mono",monospace}}
.provenance th[scope=row]{{color:var(--muted);white-space:nowrap}}
button[hidden]{{display:none}}
button{{font:inherit;font-weight:600;color:var(--accent);background:none;border:0;padding:0;margin-left:.9em;cursor:pointer}}
dialog{{width:96vw;max-width:none;max-height:96vh;border:0;border-radius:8px;padding:1.25rem;background:var(--paper);color:var(--ink)}}
dialog svg{{display:block;width:100%;max-height:84vh;min-width:0}}
dialog::backdrop{{background:rgb(0 0 0/.6)}}
dialog button{{display:block;margin:0 0 .5rem auto}}
.explorer canvas{{display:block;width:100%;touch-action:pan-y;cursor:crosshair;border-radius:2px}}
.explorer canvas:focus-visible{{outline:2px solid var(--accent);outline-offset:2px}}
.explorer output{{display:block;min-height:2.9em;font-size:.85rem;font-variant-numeric:tabular-nums;color:var(--ink)}}
.explorer .controls,.explorer .series{{display:flex;flex-wrap:wrap;gap:.35rem;align-items:center;margin:.2rem 0 .5rem;
 font-size:.85rem}}
.explorer button{{margin:0;padding:.15rem .6rem;border:1px solid var(--grid);border-radius:4px}}
.explorer .series button{{color:var(--ink);font-weight:400}}
.explorer .series button::before{{content:"";display:inline-block;width:1.1em;height:.2em;margin-right:.45em;
 vertical-align:middle;background:var(--own)}}
.explorer .series button[aria-pressed=false]{{opacity:.45;text-decoration:line-through}}
.explorer label{{display:inline-flex;gap:.4rem;align-items:center;color:var(--muted);margin-left:.5rem}}
.explorer select,.explorer input{{font:inherit;color:var(--ink);background:var(--card);border:1px solid var(--grid);
 border-radius:4px}}
@media (max-width:66rem){{
 body{{display:block;max-width:58rem;padding:0 1.1rem 3rem}}
 nav{{position:static;max-height:none;padding:1rem 0 0}}
 nav p,nav li ol{{display:none}}
 nav>ol{{display:flex;gap:.2rem 1.1rem;overflow-x:auto;white-space:nowrap}}
 nav li{{margin:0}}
 h1{{font-size:1.35rem;margin:.6rem 0}}
 .todo{{font-size:1rem}}
 .asked{{font-size:.9rem;line-height:1.35;margin:0 0 .3rem}}
 .badges{{gap:.45rem;margin:.6rem 0}}
 .badges li{{padding:.35rem .7rem}}
 .badges li span{{display:inline;margin-right:.6em}}
 .badges p{{font-size:.85rem;line-height:1.35;margin:0}}
 .verdict{{font-size:1.08rem;padding:.9rem 1.1rem}}
 dialog svg{{min-width:44rem}}
}}
@media (pointer:coarse){{
 summary,nav a,.tools a,button{{min-height:44px;min-width:44px;display:inline-flex;align-items:center}}
 button[hidden]{{display:none}}
}}
@media print{{
 body{{display:block;max-width:none;padding:0;font-size:10pt}}
 nav,.skip,.tools{{display:none}}
 figure,tr,.verdict,.badges{{break-inside:avoid}}
 .folded:not(:has(details[open])){{display:none}}
 h2,h3{{break-after:avoid}}
 .picture,.scroll{{overflow:visible}}
 .picture svg{{min-width:0;max-height:58mm;width:auto;max-width:100%}}
 figure,.table{{margin:.8rem 0 1rem}}
 h1{{margin:0 0 .6rem;font-size:1.5rem}}
 h2{{margin:1.2rem 0 .5rem}}
 details:not([open]){{display:none}}
 table{{font-size:8pt}}
 th,td{{padding:.15rem .8rem .15rem 0}}
 @page{{margin:18mm 16mm}}
}}
@media (prefers-reduced-motion:reduce){{html{{scroll-behavior:auto}}}}
"""

# the drawing moves into the dialog and back: a copy would repeat its ids
SCRIPT = """
for (const figure of document.querySelectorAll("figure")) {
  const place = figure.querySelector(".picture"), svg = place.querySelector("svg");
  const open = document.createElement("button");
  open.type = "button"; open.textContent = "Enlarge";
  open.setAttribute("aria-label", "Enlarge: " + figure.querySelector("h3").textContent);
  const enlarge = () => {
    const dialog = document.createElement("dialog"), close = document.createElement("button");
    dialog.setAttribute("aria-label", figure.querySelector("h3").textContent);
    close.type = "button"; close.textContent = "Close"; close.onclick = () => dialog.close();
    dialog.onclick = event => { if (event.target === dialog) dialog.close(); };
    place.style.minHeight = place.offsetHeight + "px";
    dialog.onclose = () => { place.append(svg); place.style.minHeight = ""; dialog.remove(); open.focus(); };
    dialog.append(close, svg); document.body.append(dialog); dialog.showModal();
  };
  open.onclick = enlarge;
  svg.style.cursor = "zoom-in"; svg.onclick = () => { if (place.contains(svg)) enlarge(); };
  figure.querySelector(".tools").append(open);
}
"""
