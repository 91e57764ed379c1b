// A button that copies a block of code: of commands, what follows the prompt.
for (const block of document.querySelectorAll("div:not(.output) > div.highlight")) {
  const button = document.createElement("button");
  button.className = "copy";
  button.textContent = "Copy";
  button.addEventListener("click", async () => {
    const lines = block.querySelector("pre").textContent.trimEnd().split("\n");
    const commands = lines.filter((line) => line.startsWith("$ "));
    const text = commands.length ? commands.map((line) => line.slice(2)) : lines;
    await navigator.clipboard.writeText(`${text.join("\n")}\n`);
    button.textContent = "Copied";
    setTimeout(() => (button.textContent = "Copy"), 1500);
  });
  block.append(button);
}

// The search field of the page of keys: rows that do not contain the words are hidden.
const field = document.getElementById("find-key");
field?.addEventListener("input", () => {
  const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const table of document.querySelectorAll("article table")) {
    const rows = [...table.querySelectorAll("tbody tr")];
    for (const row of rows) row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
    table.closest("section").hidden = words.length > 0 && !table.closest("section").querySelector("tbody tr:not([hidden])");
  }
});
