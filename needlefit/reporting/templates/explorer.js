// The interactive part of a report: an insertion with its bands and residuals, and the posterior draws.
(() => {
  const data = JSON.parse(document.getElementById("explorer-data").textContent);
  const section = document.getElementById("explorer");
  const { Plotting: plot, ColumnDataSource } = Bokeh;
  section.hidden = false;
  const quiet = { toolbar_location: "above", background_fill_color: "#ffffff", border_fill_color: "#ffffff" };

  const element = (name, text, parent) => {
    const made = document.createElement(name);
    made.textContent = text;
    parent.append(made);
    return made;
  };

  // table of insertions
  const table = document.getElementById("explorer-table");
  const head = element("tr", "", table.createTHead());
  data.heads.forEach((words, i) => { element("th", words, head).className = i < 2 ? "left" : ""; });
  const body = table.createTBody();
  const rows = data.insertions.map((one) => {
    const row = element("tr", "", body);
    one.cells.forEach((words, i) => { element("td", words, row).className = i < 2 ? "left" : ""; });
    row.tabIndex = 0;
    return row;
  });
  window.needlefitSortable(table);

  // fit and residuals of one insertion
  const source = (columns) => new ColumnDataSource({ data: Object.fromEntries(columns.map((name) => [name, []])) });
  const levels = ["95 %", "50 %"], alphas = { "95 %": 0.2, "50 %": 0.3 };
  const panel = (kind, label, height, x_range) => {
    const figure = plot.figure({
      height, sizing_mode: "stretch_width", tools: "pan,wheel_zoom,box_zoom,reset,save",
      y_axis_label: label, x_axis_label: "depth (mm)", ...(x_range ? { x_range } : {}), ...quiet,
    });
    const sources = {}, items = [];
    for (const level of levels) {
      sources[level] = source(["x_mm", "low_mm", "high_mm"]);
      const area = figure.varea({
        x: { field: "x_mm" }, y1: { field: "low_mm" }, y2: { field: "high_mm" }, source: sources[level],
        fill_color: "#0072B2", fill_alpha: alphas[level],
      });
      items.push([`${level} band`, area]);
    }
    for (const method of data.methods) {
      if (kind === "residuals" && method.key === "fitted") continue;
      sources[method.key] = source(["x_mm", "y_mm"]);
      const line = figure.line({
        x: { field: "x_mm" }, y: { field: "y_mm" }, source: sources[method.key], line_color: method.colour,
        line_width: method.key === "fitted" ? 2.2 : 1.4,
      });
      items.push([method.name, line]);
      line.visible = method.key === "fitted" || kind === "residuals" && method.key === "hand_tuned";
    }
    sources.measured = source(["x_mm", "y_mm"]);
    const dots = figure.scatter({
      x: { field: "x_mm" }, y: { field: "y_mm" }, source: sources.measured, size: 4, fill_color: "#1a1a1a",
      line_color: "#ffffff",
    });
    items.unshift(["measured", dots]);
    figure.add_tools(new Bokeh.HoverTool({
      renderers: [dots], tooltips: [["depth", "@x_mm{0.0} mm"], [kind === "curves" ? "deflection" : "minus fit", "@y_mm{0.000} mm"]],
    }));
    const entries = items.map(([label, renderer]) => new Bokeh.LegendItem({ label, renderers: [renderer] }));
    figure.add_layout(new Bokeh.Legend({
      items: entries, click_policy: "hide", label_text_font_size: "11px", border_line_color: null, spacing: 1,
    }), "right");
    return { kind, figure, sources };
  };
  const above = panel("curves", "deflection toward the bevel (mm)", 320);
  const below = panel("residuals", "deflection minus fit (mm)", 300, above.figure.x_range);
  plot.show(new Bokeh.Column({ children: [above.figure, below.figure], sizing_mode: "stretch_width" }), "#explorer-insertion");

  const badge = document.getElementById("explorer-badge"), title = document.getElementById("explorer-title");
  const choose = (number) => {
    const one = data.insertions[number];
    rows.forEach((row, i) => row.classList.toggle("chosen", i === number));
    const named = (words, i) => { // "TE (mm)" and 2.47 are TE 2.47 mm
      const [head, unit] = data.heads[i].replace(")", "").split(" (");
      return i < 2 ? words : [head, words, unit].filter(Boolean).join(" ");
    };
    title.textContent = one.cells.map(named).join(" · ");
    badge.textContent = one.status;
    badge.className = `badge ${one.status}`;
    badge.hidden = !one.status;
    for (const { kind, sources } of [above, below]) {
      for (const [name, held] of Object.entries(sources)) {
        const empty = Object.fromEntries(Object.keys(held.data).map((key) => [key, []]));
        held.data = one[kind][name] || empty;
      }
    }
  };
  rows.forEach((row, number) => {
    row.addEventListener("click", () => choose(number));
    row.addEventListener("keydown", (event) => { if (event.key === "Enter") choose(number); });
  });
  choose(data.insertions.reduce((best, one, i, all) => (one.error > all[best].error ? i : best), 0));

  // posterior: one source for all panels, so that a selection in one shows in all
  if (data.posterior) {
    const parameters = data.posterior.parameters;
    const draws = new ColumnDataSource({ data: Object.fromEntries(parameters.map((one, i) => [`p${i}`, one.values])) });
    const range = ({ values, log }) => { // of its own: a shared automatic one would follow both axes
      const at = log ? values.map(Math.log) : values;
      const [low, high] = [Math.min(...at), Math.max(...at)], room = 0.06 * (high - low) || 0.01;
      const [start, end] = [low - room, high + room].map((end) => (log ? Math.exp(end) : end));
      return new Bokeh.Range1d({ start, end });
    };
    const ranges = parameters.map(range);
    const grid = parameters.slice(1).map((up, i) => parameters.slice(0, -1).map((across, j) => {
      if (j > i) return null;
      const figure = plot.figure({
        width: 190, height: 175, tools: "box_select,lasso_select,wheel_zoom,reset",
        x_axis_type: across.log ? "log" : "linear", y_axis_type: up.log ? "log" : "linear",
        x_range: ranges[j], y_range: ranges[i + 1],
        x_axis_label: i === parameters.length - 2 ? across.label : "", y_axis_label: j === 0 ? up.label : "", ...quiet,
      });
      const dots = figure.scatter({
        x: { field: `p${j}` }, y: { field: `p${i + 1}` }, source: draws, size: 3.5, line_color: null,
        fill_color: "#0072B2", fill_alpha: 0.5,
      });
      for (const axis of [...figure.xaxis, ...figure.yaxis]) axis.ticker.desired_num_ticks = 3;
      figure.add_tools(new Bokeh.HoverTool({
        renderers: [dots], tooltips: [[across.label, `@p${j}{0.000 a}`], [up.label, `@p${i + 1}{0.000 a}`]],
      }));
      return figure;
    }));
    plot.show(plot.gridplot(grid, { toolbar_location: "above" }), "#explorer-posterior");
    document.getElementById("explorer-draws").hidden = false;
  }
})();
