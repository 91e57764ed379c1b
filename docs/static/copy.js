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
