def names(): return []
def pages(): return {"effects/index.md": "# Effects\n"}
